"""The robot with legs on CAN as a user runs it: real processes, real pseudo-terminals, slcan text."""

from pathlib import Path

from tests.support.processes import Daemon, Virtual, arm, daemon, go, patiently, robot, until

BUSES = ["upper", "l_leg", "r_leg"]
BEND = {
    "joint_names": ["head_yaw", "l_knee", "r_knee", "l_hip_pitch", "r_hip_pitch"],
    "points": [
        {"positions": [0.4, 0.6, 0.6, -0.3, -0.3], "time_from_start": 1.0},
        {"positions": [0.0, 0.0, 0.0, 0.0, 0.0], "time_from_start": 2.0},
    ],
}


def torque(virtual: Virtual) -> list[bool]:
    return [bool(servo["torque"]) for servo in virtual.servos()]


def test_a_motion_runs_on_serial_and_can_buses_at_once() -> None:
    with robot("h24-mixed") as (virtual, folder), daemon(virtual, folder) as running:
        assert list(virtual.ports) == BUSES
        status = running.reach(state="connected")
        links = [str(folder / "ports" / bus) for bus in BUSES]
        assert [bus["port"] for bus in status["buses"]] == [
            links[0],
            f"can:slcan:{links[1]}",
            f"can:slcan:{links[2]}",
        ]
        # Until its model is loaded a path waits, and the lease runs out meanwhile.
        until(lambda: "LOOKAHEAD" in running.log.read_text(), 30.0, "the front looks ahead")
        with running.client() as client:
            arm(client)
            assert torque(virtual) == [True] * 24
            assert go(client, BEND)["phase"] == "succeeded"
            assert running.status()["skew_max_ms"] > 0.0
            assert client.call("Disarm")["state"] == "connected"
        assert torque(virtual) == [False] * 24
        assert running.end() == 0


def test_a_leg_that_is_unplugged_is_lost_and_found_again_over_its_link() -> None:
    with robot("h24-mixed") as (virtual, folder), daemon(virtual, folder) as running:
        running.reach(state="connected")
        with running.client() as client:
            arm(client)
            virtual.order(fault="unplug", bus="r_leg")
            status = running.reach(state="fault")
            assert [bus["connected"] for bus in status["buses"]] == [True, True, False]
            assert any(fault["code"] == "PORT_LOST" for fault in status["faults"])
            virtual.order(fault="replug", bus="r_leg", renamed=True)
            until(lambda: all(bus["connected"] for bus in running.status()["buses"]), 10.0, "all are back")
            patiently(lambda: client.call("Disarm"))
        until(lambda: not any(torque(virtual)), 10.0, "torque off")
        assert running.end() == 0


def test_the_daemon_brings_its_own_virtual_robot_with_can_buses(tmp_path: Path) -> None:
    running = Daemon(tmp_path / "run", "--virtual", "--robot", "h24-mixed", "--mode", "mirror")
    status = running.reach(state="connected")
    assert [bus["name"] for bus in status["buses"]] == BUSES
    assert [bus["port"].startswith("can:slcan:/dev/pts/") for bus in status["buses"]] == [False, True, True]
    assert running.end() == 0
