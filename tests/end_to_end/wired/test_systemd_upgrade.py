"""The package of 0.1.0, configured and with an armed robot, upgraded by dpkg under a service manager.

The robot is virtual and stays as it is: servos of 0.1.0, on a pseudo-terminal.
"""

import hashlib
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support import built_package as built
from tests.support.doc_pages_text import ROOT
from tests.support.processes import arm, go
from tests.support.systemd.machine import Machine, why_not
from tests.support.systemd.service import Robot, Service, settings
from twind.version import __version__

pytestmark = pytest.mark.campaign  # two packages are built and installed: some two minutes
SECONDS = 240.0  # for one run of dpkg on a busy machine
OLD = "2d1dfd9"  # 0.1.0, see CHANGELOG.md
ONLY_OLD = ["structlog>=25.1"]  # needed by 0.1.0, and by this version no more
FILES = ROOT / "tests/data/version_0_1_0"
STATE = "/var/lib/twind"
CALIBRATION = f"{STATE}/calibration/mine-0001.yaml"
# Its owner's: settings, robot, model, calibration; and an example that the owner edited.
OWN = ("/etc/twind/twind.yaml", "/etc/twind/robots/mine.yaml", "/etc/twind/robots/h24.xml", CALIBRATION)
EDITED = "/etc/twind/robots/example.yaml"
EXAMPLE = "/etc/twind/robots/example.xml"  # the owner never touched it
READ = """
import sys
from pathlib import Path
from twind.observe.recording import open_recording
for each in sys.argv[1:]:
    found = open_recording(Path(each))
    print(found.robot["name"], len(found.measured), repr(found.damage))
"""


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Packages of 0.1.0 and of this version."""
    if (reason := why_not()) is not None:
        pytest.skip(reason)
    built.require_debian()
    below = built.shared(tmp_path_factory)
    return built.former(below, OLD, ONLY_OLD), built.package(below)


@pytest.fixture(scope="module")
def machine(packages: tuple[Path, Path]) -> Iterator[Machine]:
    """A machine with 0.1.0 and what its owner wrote there."""
    made = Machine(lambda tree: tree.mkdir(), {})
    try:
        made.boot()
        for name, package in zip(("old", "new"), packages, strict=True):
            shutil.copy(package, made.inside(f"/tmp/{name}.deb"))
        made.run("dpkg", "-i", "/tmp/old.deb", seconds=SECONDS)
        for each in ("mine.yaml", "h24.xml"):
            shutil.copy(FILES / each, made.inside("/etc/twind/robots"))
        with made.inside(EDITED).open("a") as edited:
            edited.write("# edited\n")
        yield made
    finally:
        made.down()


@pytest.fixture(scope="module")
def robot(machine: Machine) -> Iterator[Robot]:
    """Its servos, and their calibration where a robot of 0.1.0 has it."""
    made = Robot(machine, "mine", "/etc/twind/robots/mine.yaml")
    place = machine.inside(CALIBRATION)
    place.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy(made.calibration, place)
    yield made
    made.close()


@pytest.fixture(scope="module")
def service(machine: Machine, robot: Robot) -> Iterator[Service]:
    """The service of 0.1.0, whose robot is armed."""
    own = {"mode": "live", "robot": "mine", "individual": "mine-0001", "ports": robot.settings()["ports"]}
    settings(machine, "twind", own)
    made = Service(machine).start()
    made.reach(version="0.1.0", state="connected")
    _turn(made, 0.3)
    machine.run("twindctl", "dump", "before")
    yield made
    made.stop()


def _turn(service: Service, radians: float) -> None:
    """The head, by an operator who arms the robot where it is not."""
    with service.client() as client:
        if not client.call("GetStatus")["status"]["armed"]:
            arm(client)
        go(
            client,
            {"joint_names": ["head_yaw"], "points": [{"positions": [radians], "time_from_start": 0.8}]},
        )


def _digests(machine: Machine) -> dict[str, str]:
    flights = machine.run("find", f"{STATE}/flight", "-name", "*before*.flight").split()
    assert flights
    return {
        each: hashlib.sha256(machine.inside(each).read_bytes()).hexdigest()
        for each in (*OWN, EDITED, *flights)
    }


def test_an_upgrade_leaves_the_daemon_and_its_armed_robot_alone_and_keeps_files(
    machine: Machine, robot: Robot, service: Service
) -> None:
    before = (service.show("MainPID"), robot.torque(), _digests(machine))
    example = machine.inside(EXAMPLE).read_bytes()
    said = machine.run("dpkg", "-i", "/tmp/new.deb", seconds=SECONDS)
    assert "still runs" in said  # the environment of the daemon
    assert (service.show("MainPID"), robot.torque(), _digests(machine)) == before
    assert before[1] == {True}
    assert machine.inside(EXAMPLE).read_bytes() != example
    assert service.status()["version"] == "0.1.0"
    assert machine.run("twind", "--version").split()[-1] == __version__


def test_programs_of_this_version_command_the_daemon_of_the_old_one(service: Service, robot: Robot) -> None:
    """Until its owner restarts it."""
    service.reach(version="0.1.0")
    places = robot.places()
    service.machine.run("twindctl", "status")
    _turn(service, -0.3)
    assert robot.places() != places


def test_after_a_restart_this_version_drives_the_robot_with_the_files_of_the_old_one(
    machine: Machine, robot: Robot, service: Service
) -> None:
    machine.run("systemctl", "restart", "twind.service", seconds=60.0)
    assert robot.torque() == {False}  # it was lowered, and nothing arms it
    service.reach(version=__version__, mode="live", robot="mine", state="connected")
    _turn(service, 0.2)
    assert robot.torque() == {True}
    programs = machine.run("readlink", "-f", "/opt/twind/bin").strip()
    flights = [each for each in _digests(machine) if each.endswith(".flight")]
    read = machine.run(f"{programs}/python", "-I", "-c", READ, *flights)
    name, readings, damage = read.split()
    assert (name, damage) == ("mine", "''") and int(readings) > 100


def test_the_environment_of_the_old_version_goes_once_nothing_runs_from_it(
    machine: Machine, robot: Robot, service: Service
) -> None:
    service.stop()
    robot.close()
    machine.run("dpkg", "-i", "/tmp/new.deb", seconds=SECONDS)
    (left,) = machine.inside("/opt/twind/versions").iterdir()
    assert left.name.startswith(f"{__version__}-")
    named = machine.run("find", "/usr/lib/twind", "/opt/twind", "-name", "twind-0.1.0*").split()
    assert named == []
