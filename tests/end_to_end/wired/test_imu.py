"""The IMU over a real pseudo-terminal: what a daemon tells of it, what scan and doctor make of it."""

import json
from collections.abc import Iterator
from math import hypot
from pathlib import Path
from typing import Any

import pytest

from tests.support.doctor_rig import options
from tests.support.doctor_surveys import CHECKS
from tests.support.processes import Daemon, Virtual, daemon, robot, until
from twind.client import Client
from twind.ctl.ctl_main import main
from twind.doctor import runner
from twind.doctor.check_context import examine
from twind.doctor.host_inspector import HostInspector
from twind.robot.attitude import G
from twind_drivers.clock import MonotonicClock

ID = 200


@pytest.fixture(scope="module")
def standing() -> Iterator[tuple[Virtual, Path]]:
    with robot("h24-standing") as made:
        yield made


def complaints(virtual: Virtual, running: Daemon | None = None) -> dict[str, str]:
    """Findings of the doctor about buses and servos: code -> measured value."""
    words = ["--robot", "h24-standing", "--calibration", str(virtual.calibration)]
    words += [] if running else ["--port", str(virtual.folder / "ports/main")]
    socket = running.sockets if running else "/nowhere/at/all"
    seen = examine(options(*words, socket=socket), HostInspector(), MonotonicClock())
    try:
        found = runner.run(seen, CHECKS, runner.table()).found
    finally:
        seen.close()
    assert all(str(ID) not in each.thing or each.thing.endswith("(IMU)") for each in found), found
    return {each.code: f"{each.thing}: {each.measured}" for each in found}


def test_the_imu_is_not_taken_for_a_servo_and_the_doctor_names_its_faults(
    standing: tuple[Virtual, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    virtual, _ = standing
    none = {"SERVO_MISSING", "IMU_GRAVITY", "SERVO_FOREIGN", "SERVO_MODEL"}
    assert complaints(virtual).keys().isdisjoint(none)
    assert main(["--json", "scan", "--port", str(virtual.folder / "ports/main"), "--baud", "2000000"]) == 0
    said = [json.loads(each) for each in capsys.readouterr().out.splitlines()]
    assert [each["id"] for each in said] == [*range(1, 25), ID] and not any(each["trouble"] for each in said)
    virtual.order(fault="silence", id=ID)
    assert complaints(virtual)["SERVO_MISSING"] == f"bus main id {ID} (IMU): no answer"
    virtual.order(fault="silence", id=ID, on=False)
    virtual.order(fault="imu", acceleration_noise=100.0)
    assert "m/s²" in complaints(virtual)["IMU_GRAVITY"]
    virtual.order(fault="imu")


def test_a_daemon_publishes_the_imu_with_the_state_and_continues_without_it(
    standing: tuple[Virtual, Path],
) -> None:
    virtual, folder = standing
    with daemon(virtual, folder, mode="mirror") as running:
        running.reach(state="connected")
        with running.client() as client:
            told = [imu_state(client) for _ in range(20)]
            assert all(hypot(*each["acceleration"]) == pytest.approx(G, rel=0.01) for each in told)
            assert all(each["quaternion"] == pytest.approx([1, 0, 0, 0], abs=0.01) for each in told)
            assert min(each["age_ms"] for each in told) < 20.0
            virtual.order(fault="silence", id=ID)
            until(lambda: imu_state(client)["age_ms"] > 1500.0, 20.0, "an old reading with its age")
            state = client.call("Monitor", topics=["state"])
            assert all(joint["age_ms"] < 1000.0 for joint in state["joints"]), "the servos do not mind"
            assert complaints(virtual, running)["SERVO_MISSING"] == f"bus main id {ID} (IMU): no answer"
            virtual.order(fault="silence", id=ID, on=False)
            until(lambda: imu_state(client)["age_ms"] < 50.0, 20.0, "it is back")
        running.end()


def imu_state(client: Client) -> dict[str, Any]:
    """The IMU of one message of the topic state."""
    found: dict[str, Any] = client.call("Monitor", topics=["state"])["imu"]
    return found
