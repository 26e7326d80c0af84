"""The Debian package where a service manager runs: installed, started, installed again, removed, purged."""

import re
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
STAMP = "/tmp/before"
# Data bases of users, packages and manuals, and of the service manager itself.
KEPT = re.compile(
    r"/(etc/((passwd|group|shadow|gshadow|subuid|subgid)-?|[.]pwd[.]lock)|var/(lib/(dpkg|systemd)|cache/man|log)/.*"
    r"|run/(systemd|log|udev)/.*|tmp/.*)"
)


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
        made.inside(STAMP).touch()
        yield made
    finally:
        made.down()


@pytest.fixture(scope="module")
def installed(bare: Machine) -> Machine:
    """The same, once the package is installed."""
    bare.run("dpkg", "-i", PACKAGE, seconds=SECONDS)
    return bare


def listed(machine: Machine, kind: str) -> str:
    """Services and sockets of twind that systemd knows."""
    named = ("--all", "--type=service,socket", "--plain", "--no-legend", "twind*")
    return machine.try_run("systemctl", kind, *named).stdout  # a list of none may be a failure


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
    installed.run("rm", "-r", folder)


def test_a_package_that_goes_stops_what_runs_and_leaves_the_settings(installed: Machine) -> None:
    others = ("twind-sim.service", "twind-metrics.service", "twind-stream.service")
    for unit in ("twind.service", *others):
        Service(installed, unit).start()
    assert installed.inside("/var/lib/private/twind-stream").is_dir()
    installed.try_run("systemctl", "start", "twind-uplink.service")  # its extra is not here: it fails
    installed.run("systemctl", "enable", "twind.service", "twind-observe.socket", *others)
    installed.run("dpkg", "-r", "twind", seconds=SECONDS)
    assert listed(installed, "list-units") == ""
    assert not list(installed.inside("/etc/systemd/system").glob("*.wants/twind*"))
    assert not installed.inside("/opt/twind").exists()
    assert Path(installed.inside("/etc/twind/twind.yaml")).exists()


def test_a_package_that_is_purged_leaves_nothing_but_its_user(installed: Machine) -> None:
    """No file, folder, link, unit, socket or process. User and groups stay: files elsewhere may be theirs."""
    installed.run("dpkg", "-P", "twind", seconds=SECONDS)
    looked = ("/etc", "/opt", "/usr", "/var", "/run", "/dev/shm")
    found = installed.run("find", *looked, "-xdev", "!", "-type", "d", "-cnewer", STAMP, seconds=SECONDS)
    assert {path for path in found.split() if not KEPT.fullmatch(path)} == set()
    named = installed.run("find", *looked, "-xdev", "-name", "*twind*", seconds=SECONDS).split()
    assert {path for path in named if not KEPT.fullmatch(path) and "twind-tests" not in path} == set()
    installed.run("getent", "passwd", "twind")
    for kind in ("list-units", "list-unit-files", "list-sockets"):
        assert listed(installed, kind) == "", kind
    assert "twind" not in installed.run("cat", "/proc/net/unix")
    running = [Path(f"/proc/{pid}/cmdline").read_bytes() for pid in installed.pids("/")]
    assert not [command for command in running if b"/opt/twind" in command]
