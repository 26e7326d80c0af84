"""The Debian package where a service manager runs: installed, started, installed again, removed."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support import built_package as built
from tests.support.systemd.machine import Machine, why_not
from tests.support.systemd.service import Service

pytestmark = pytest.mark.slow
SECONDS = 120.0  # for one run of dpkg on a busy machine
PACKAGE = "/tmp/twind.deb"


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machine]:
    """A machine that has nothing of twind but the package's file."""
    if (reason := why_not()) is not None:
        pytest.skip(reason)
    built.require_debian()
    package = built.package(built.shared(tmp_path_factory))
    made = Machine(lambda tree: tree.mkdir(), {})
    try:
        made.boot()
        shutil.copy(package, made.inside(PACKAGE))
        yield made
    finally:
        made.down()


@pytest.fixture(scope="module")
def installed(bare: Machine) -> Machine:
    """The same, once the package is installed."""
    bare.run("dpkg", "-i", PACKAGE, seconds=SECONDS)
    return bare


def test_a_package_starts_nothing_and_the_next_one_keeps_what_runs(installed: Machine) -> None:
    service = Service(installed)
    assert service.show("ActiveState") == "inactive"
    assert service.show("UnitFileState") == "disabled"
    service.start()
    before = service.show("MainPID")
    installed.run("dpkg", "-i", PACKAGE, seconds=SECONDS)
    assert service.show("MainPID") == before
    assert service.show("ActiveState") == "active"
    service.stop()


def test_a_virtual_robot_lives_in_the_fence_of_the_service(installed: Machine) -> None:
    """Pseudo-terminals made and opened under its device rules, muscles under its memory rules."""
    folder = "/etc/systemd/system/twind.service.d"
    installed.run("install", "-D", "-t", folder, "/usr/share/doc/twind/examples/virtual.conf")
    installed.run("systemctl", "daemon-reload")
    service = Service(installed).start()
    status = service.reach(mode="live", state="connected")
    assert status["buses"][0]["connected"]
    service.stop()
    assert service.show("Result") == "success"


def test_a_package_that_goes_stops_what_runs_and_leaves_the_settings(installed: Machine) -> None:
    Service(installed).start()
    installed.run("systemctl", "enable", "twind.service", "twind-observe.socket")
    installed.run("dpkg", "-r", "twind", seconds=SECONDS)
    assert installed.try_run("systemctl", "is-active", "twind.service").stdout.strip() == "inactive"
    assert not list(installed.inside("/etc/systemd/system").glob("*.wants/twind*"))
    assert not installed.inside("/opt/twind").exists()
    assert Path(installed.inside("/etc/twind/twind.yaml")).exists()
