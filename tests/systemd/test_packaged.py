"""The Debian package where a service manager runs: installed, started, installed again, removed."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import built
import pytest
from machine import Machine, why_not
from service import Service

pytestmark = [pytest.mark.realtime, pytest.mark.slow]
SECONDS = 120.0  # for one run of dpkg on a busy machine
PACKAGE = "/tmp/twind.deb"


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machine]:
    """A machine that has nothing of twind but the package's file."""
    if (reason := why_not()) is not None:
        pytest.skip(reason)
    built.require_debian()
    package = built.package(tmp_path_factory.getbasetemp())
    made = Machine(lambda tree: tree.mkdir(), {})
    try:
        made.boot()
        shutil.copy(package, made.inside(PACKAGE))
        yield made
    finally:
        made.down()


def test_a_package_starts_nothing_keeps_what_runs_and_stops_it_when_it_goes(bare: Machine) -> None:
    service = Service(bare)
    bare.run("dpkg", "-i", PACKAGE, seconds=SECONDS)
    assert service.show("ActiveState") == "inactive"
    assert service.show("UnitFileState") == "disabled"
    service.start()
    before = service.show("MainPID")
    bare.run("dpkg", "-i", PACKAGE, seconds=SECONDS)
    assert service.show("MainPID") == before
    assert service.show("ActiveState") == "active"
    bare.run("systemctl", "enable", "twind.service", "twind-observe.socket")
    bare.run("dpkg", "-r", "twind", seconds=SECONDS)
    assert bare.try_run("systemctl", "is-active", "twind.service").stdout.strip() == "inactive"
    assert not list(bare.inside("/etc/systemd/system").glob("*.wants/twind*"))
    assert not bare.inside("/opt/twind").exists()
    assert Path(bare.inside("/etc/twind/twind.yaml")).exists()


def test_a_virtual_robot_lives_in_the_fence_of_the_service(bare: Machine) -> None:
    """Pseudo-terminals made and opened under its device rules, muscles under its memory rules."""
    bare.run("dpkg", "-i", PACKAGE, seconds=SECONDS)
    folder = "/etc/systemd/system/twind.service.d"
    bare.run("install", "-D", "-t", folder, "/usr/share/doc/twind/examples/virtual.conf")
    bare.run("systemctl", "daemon-reload")
    service = Service(bare).start()
    status = service.reach(mode="live", state="connected")
    assert status["buses"][0]["connected"]
    service.stop()
    assert service.show("Result") == "success"
