"""The daemon as a user runs it: real processes, real pseudo-terminals, real signals."""

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from tests.support.live_robot import LiveRobot, live_robot
from tests.support.processes import Daemon, arm, daemon, go, patiently, robot, unread_pipe, until
from twind.client import ClientError, Refused

COUNTS = 2  # what a joint may move where nothing may move


@pytest.fixture(scope="module")
def shared() -> Iterator[LiveRobot]:
    with live_robot() as made:
        yield made


@pytest.fixture
def live(shared: LiveRobot) -> LiveRobot:
    """A connected robot without torque."""
    shared.ready()
    return shared


def test_a_second_daemon_on_the_same_port_is_refused_with_the_pid_of_the_first(live: LiveRobot) -> None:
    port = f"main={live.folder / 'ports' / 'main'}"
    second = Daemon(live.folder / "other", "--mode", "mirror", "--port", port)
    assert second.end(signal.SIGCONT) == 1
    assert str(live.running.process.pid) in second.log.read_text()
    assert live.running.status()["state"] == "connected"


def test_an_unplugged_bus_is_found_again_under_its_stable_name_and_stays_disarmed(live: LiveRobot) -> None:
    away = {"positions": [0.4], "time_from_start": 3.0}
    live.expected_faults = {"PORT_LOST"}
    with live.running.client() as client:
        arm(client)

        def begin() -> None:
            client.call("AcquireLease")
            client.call("SubmitTrajectory", trajectory={"joint_names": ["head_pitch"], "points": [away]})

        patiently(begin)
        live.running.reach(motion="active")
        live.virtual.order(fault="unplug", bus="main")
        live.running.reach(seconds=5.0, armed=False, hw_connected=False)
        until(lambda: all(servo["tripped"] for servo in live.virtual.servos()), 5.0, "watchdogs trip")
        until(lambda: all(abs(servo["velocity"]) < 1 for servo in live.virtual.servos()), 5.0, "rest")
        rest = live.places()
        live.virtual.order(fault="replug", bus="main")
        status = live.running.reach(seconds=5.0, hw_connected=True)
    assert (status["armed"], status["inherited"], status["state"]) == (False, True, "fault")
    time.sleep(0.5)
    assert live.moved(rest) <= COUNTS


def test_sigterm_lowers_the_robot_before_torque_goes_off(live: LiveRobot) -> None:
    rest = live.places()
    raised = {"positions": [-0.8], "time_from_start": 1.0}
    with live.running.client() as client:
        arm(client)
        go(client, {"joint_names": ["r_shoulder_pitch"], "points": [raised]})
        assert live.moved(rest) > 300
        assert live.running.end() == 0
    assert live.torque() == {False}
    assert live.moved(rest) < 60


def test_sigterm_completes_a_disarm_of_torque_that_was_found(live: LiveRobot) -> None:
    with live.running.client() as client:
        arm(client)
    live.running.kill()
    live.start().reach(state="connected", inherited=True)

    def disarm() -> None:
        with suppress(ClientError), live.running.client() as client:
            client.call("Disarm")

    asked = threading.Thread(target=disarm)
    asked.start()
    live.running.reach(state="settling")
    assert live.running.end() == 0, live.running.log.read_text()
    asked.join(10)
    assert live.torque() == {False}


def test_an_unread_log_pipe_delays_no_tick(shared: LiveRobot) -> None:
    shared.running.end()
    seconds = 3.0
    with unread_pipe() as pipe, daemon(shared.virtual, shared.folder, stderr=pipe) as running:
        before = running.reach(state="connected")["loop"]
        began = time.monotonic()
        stops = 0
        with running.client() as client:
            client.call("AcquireLease")
            while time.monotonic() < began + seconds:  # a line of the log each
                client.call("EStop", reason="x" * 200)
                client.call("Reset")
                stops = stops + 1
        after = running.status()["loop"]
        rate = (after["ticks"] - before["ticks"]) / (time.monotonic() - began)
    assert stops > 20
    print(f"{stops} stops, {rate:.1f} Hz")
    assert rate > 80.0


def test_a_daemon_without_its_robot_keeps_running_and_logs_the_missing_port(tmp_path: Path) -> None:
    running = Daemon(tmp_path / "run", "--mode", "mirror", "--port", f"main={tmp_path / 'ttyUSB0'}")
    try:
        running.reach(state="disconnected", mode="mirror")
        until(lambda: "ttyUSB0" in running.log.read_text(), 10.0, "the log names the port")
        assert running.end() == 0
    finally:
        running.kill()


@pytest.mark.parametrize("port", [(), ("--port", "/dev/ptmx")])
def test_live_without_port_or_calibration_is_a_usage_error(tmp_path: Path, port: tuple[str, ...]) -> None:
    running = Daemon(tmp_path / "run", "--mode", "live", *port)
    assert running.end(signal.SIGCONT) == 2
    assert ("calibration" if port else "--port") in running.log.read_text()


def test_a_wrong_baud_rate_reports_every_device_as_missing() -> None:
    slow = ("h24", "--baud", "1000000", "--muscles", "first-order")
    with robot(*slow) as (virtual, folder), daemon(virtual, folder) as running:
        running.reach(state="identifying", armed=False)
        faults = until(lambda: running.status()["faults"], 5.0, "faults of missing devices")
        assert {fault["code"] for fault in faults} == {"DEVICE_MISSING"}
        assert "baud" in faults[0]["message"] or "id 1" in faults[0]["message"], faults
        with running.client() as client:
            client.call("AcquireLease")
            with pytest.raises(Refused):
                client.call("Arm")
