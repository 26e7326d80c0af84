"""The daemon as a user runs it: real processes, real pseudo-terminals, real signals."""

import os
import signal
import time
from pathlib import Path

import pytest

from tests.support.processes import Daemon, Virtual, arm, daemon, go, patiently, robot, until
from twind.client import Client, Refused

COUNTS = 2  # what a joint may move where nothing may move


def places(virtual: Virtual) -> list[float]:
    return [servo["position"] for servo in virtual.servos()]


def moved(virtual: Virtual, before: list[float]) -> float:
    return max(abs(now - then) for now, then in zip(places(virtual), before, strict=True))


def nod(seconds: float) -> dict[str, object]:
    """Away and back, slowly."""
    away = {"positions": [0.4], "time_from_start": seconds / 2}
    back = {"positions": [0.0], "time_from_start": seconds}
    return {"joint_names": ["head_pitch"], "points": [away, back]}


def follow(client: Client, trajectory: dict[str, object], until_progress: float) -> None:
    """Begin a motion and follow it until it has come far enough, or has ended before."""

    def begin() -> None:
        client.call("AcquireLease")  # arming may have taken longer than it lasts
        for answer in client.stream("SubmitTrajectory", trajectory=trajectory):
            if answer["phase"] == "running" and answer["progress"] > until_progress:
                break

    patiently(begin)


def test_sigkill_of_the_loop_stops_every_servo_by_its_own_watchdog_and_a_restart_moves_nothing() -> None:
    with robot() as (virtual, folder):
        with daemon(virtual, folder) as first:
            first.reach(state="connected")
            with first.client() as client:
                arm(client)
                follow(client, nod(4.0), 0.3)
                assert first.end(signal.SIGKILL) == -signal.SIGKILL
        until(lambda: all(servo["tripped"] for servo in virtual.servos()), 5.0, "watchdogs trip")
        servos = virtual.servos()
        delays = [servo["trip_delay"] for servo in servos]
        assert max(delays) <= 0.120, delays
        assert all(servo["torque"] and servo["watchdog"] == 255 for servo in servos)
        until(lambda: all(abs(servo["velocity"]) < 1 for servo in virtual.servos()), 5.0, "rest")
        rest = places(virtual)
        with daemon(virtual, folder) as second:
            second.reach(state="connected", inherited=True, armed=False)
            time.sleep(1.0)
            assert moved(virtual, rest) <= COUNTS
            with second.client() as client:
                arm(client)
                assert second.status()["armed"] is True
                assert not any(servo["tripped"] for servo in virtual.servos())
                assert moved(virtual, rest) <= 20  # goal := present gives up what gravity had bent
                assert client.call("Disarm")["state"] == "connected"
            assert second.end() == 0
        assert not any(servo["torque"] for servo in virtual.servos())


def test_sigkill_of_the_front_holds_the_motion_keeps_torque_and_a_new_front_answers() -> None:
    with robot() as (virtual, folder), daemon(virtual, folder) as running:
        running.reach(state="connected")
        with running.client() as client:
            arm(client)
            follow(client, nod(6.0), 0.2)
            os.kill(running.front(), signal.SIGKILL)
            killed = time.monotonic()
        status = running.reach(seconds=10.0, state="armed", motion="holding")
        back = time.monotonic() - killed
        assert status["lease"] is None
        assert all(servo["torque"] for servo in virtual.servos())
        still = places(virtual)
        time.sleep(0.5)
        assert moved(virtual, still) <= COUNTS
        print(f"front back after {back:.2f} s")
        assert running.end() == 0
        assert not any(servo["torque"] for servo in virtual.servos())


def test_sigterm_lowers_the_robot_before_torque_goes_off() -> None:
    with robot() as (virtual, folder), daemon(virtual, folder) as running:
        running.reach(state="connected")
        rest = places(virtual)
        with running.client() as client:
            arm(client)
            path = {
                "joint_names": ["r_shoulder_pitch"],
                "points": [{"positions": [-0.8], "time_from_start": 1.0}],
            }
            go(client, path)
            assert moved(virtual, rest) > 300
            assert running.end() == 0
        assert not any(servo["torque"] for servo in virtual.servos())
        assert moved(virtual, rest) < 60


def test_a_second_daemon_on_the_same_port_is_refused_with_the_pid_of_the_first() -> None:
    with robot() as (virtual, folder), daemon(virtual, folder) as first:
        first.reach(state="connected")
        second = Daemon(folder / "other", "--mode", "mirror", "--port", f"main={folder / 'ports' / 'main'}")
        assert second.end(signal.SIGCONT) == 1
        said = second.log.read_text()
        assert str(first.process.pid) in said, said
        assert first.status()["state"] == "connected"


def test_an_unplugged_bus_is_found_again_under_its_stable_name_and_stays_disarmed() -> None:
    with robot() as (virtual, folder), daemon(virtual, folder) as running:
        running.reach(state="connected")
        with running.client() as client:
            arm(client)
            follow(client, nod(6.0), 0.2)
            virtual.order(fault="unplug", bus="main")
            running.reach(seconds=5.0, armed=False, hw_connected=False)
            time.sleep(0.5)
            rest = places(virtual)
            virtual.order(fault="replug", bus="main")
            status = running.reach(seconds=5.0, hw_connected=True)
        assert (status["armed"], status["inherited"], status["state"]) == (False, True, "fault")
        time.sleep(0.5)
        assert moved(virtual, rest) <= COUNTS


def test_a_daemon_without_its_robot_keeps_running_and_logs_the_missing_port(tmp_path: Path) -> None:
    running = Daemon(tmp_path / "run", "--mode", "mirror", "--port", f"main={tmp_path / 'ttyUSB0'}")
    try:
        status = running.reach(state="disconnected")
        assert status["mode"] == "mirror"
        until(lambda: "ttyUSB0" in running.log.read_text() or None, 10.0, "the log names the port")
        assert running.end() == 0
    finally:
        running.end(signal.SIGKILL)


def test_live_without_port_or_calibration_is_a_usage_error(tmp_path: Path) -> None:
    for options in (["--mode", "live"], ["--mode", "live", "--port", "/dev/ptmx"]):
        running = Daemon(tmp_path / "run", *options)
        assert running.end(signal.SIGCONT) == 2
    assert "calibration" in running.log.read_text()


def test_a_wrong_baud_rate_reports_every_device_as_missing() -> None:
    with robot("h24", "--baud", "1000000") as (virtual, folder), daemon(virtual, folder) as running:
        status = running.reach(state="identifying")
        faults = until(lambda: running.status()["faults"], 5.0, "missing devices are named")
        assert {fault["code"] for fault in faults} == {"DEVICE_MISSING"}
        assert "baud" in faults[0]["message"] or "id 1" in faults[0]["message"]
        assert status["armed"] is False
        with running.client() as client:
            client.call("AcquireLease")
            with pytest.raises(Refused):
                client.call("Arm")
