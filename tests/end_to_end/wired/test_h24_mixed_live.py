"""The robot with legs on CAN as a user runs it: real processes, real pseudo-terminals, slcan text."""

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.live_robot import LiveRobot, live_robot
from tests.support.processes import Daemon, arm, go, patiently, until

BUSES = ["upper", "l_leg", "r_leg"]
BEND = {
    "joint_names": ["head_yaw", "l_knee", "r_knee", "l_hip_pitch", "r_hip_pitch"],
    "points": [
        {"positions": [0.4, 0.6, 0.6, -0.3, -0.3], "time_from_start": 1.0},
        {"positions": [0.0, 0.0, 0.0, 0.0, 0.0], "time_from_start": 2.0},
    ],
}


@pytest.fixture(scope="module")
def mixed() -> Iterator[LiveRobot]:
    with live_robot("h24-mixed") as made:
        yield made


def test_a_motion_runs_on_serial_and_can_buses_at_once(mixed: LiveRobot) -> None:
    assert list(mixed.virtual.ports) == BUSES
    mixed.ready()
    links = [str(mixed.folder / "ports" / bus) for bus in BUSES]
    ports = [links[0], f"can:slcan:{links[1]}", f"can:slcan:{links[2]}"]
    assert [bus["port"] for bus in mixed.running.status()["buses"]] == ports
    # Until its model is loaded a path waits, and the lease runs out meanwhile.
    until(lambda: "LOOKAHEAD" in mixed.running.log.read_text(), 30.0, "the front's model")
    with mixed.running.client() as client:
        arm(client)
        assert mixed.torque() == {True}
        assert go(client, BEND)["phase"] == "succeeded"
        assert mixed.running.status()["skew_max_ms"] > 0.0
        assert client.call("Disarm")["state"] == "connected"
    assert mixed.torque() == {False}


def test_a_leg_that_is_unplugged_is_lost_and_found_again_over_its_link(mixed: LiveRobot) -> None:
    mixed.ready()
    with mixed.running.client() as client:
        arm(client)
        mixed.virtual.order(fault="unplug", bus="r_leg")
        status = mixed.running.reach(state="fault")
        assert [bus["connected"] for bus in status["buses"]] == [True, True, False]
        assert any(fault["code"] == "PORT_LOST" for fault in status["faults"])
        mixed.virtual.order(fault="replug", bus="r_leg", renamed=True)
        until(lambda: all(bus["connected"] for bus in mixed.running.status()["buses"]), 10.0, "all are back")
        patiently(lambda: client.call("Disarm"))
    until(lambda: mixed.torque() == {False}, 10.0, "torque off")
    assert mixed.running.end() == 0


def test_the_daemon_brings_its_own_virtual_robot_with_can_buses_and_removes_its_sockets(
    tmp_path: Path,
) -> None:
    running = Daemon(tmp_path / "run", "--virtual", "--robot", "h24-mixed", "--mode", "mirror")
    status = running.reach(state="connected")
    assert [bus["name"] for bus in status["buses"]] == BUSES
    assert [bus["port"].startswith("can:slcan:/dev/pts/") for bus in status["buses"]] == [False, True, True]
    assert running.end(signal.SIGINT) == 0  # Ctrl-C
    assert not list(running.sockets.glob("*.sock"))
