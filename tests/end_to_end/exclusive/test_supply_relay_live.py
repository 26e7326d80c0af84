"""Supply relay and stop button of a real daemon: its process, a virtual robot, real signals."""

import os
import signal
from contextlib import suppress
from pathlib import Path

from tests.support.processes import Daemon, arm, daemon, until
from tests.support.relay_runs import opening_time, power, powered_robot, wait_closed
from twind.client import CallError, Client

WITHIN = 0.15  # s from the signal to the open relay


def test_the_relay_opens_without_the_loop_and_the_button_stops_the_robot(tmp_path: Path) -> None:
    with powered_robot(tmp_path, "cut") as virtual:
        assert not power(virtual)["closed"]
        for number in (signal.SIGKILL, signal.SIGSTOP):
            with daemon(virtual, tmp_path) as running:
                status = running.reach(state="connected", supply_relay="closed", stop_button="released")
                assert not status["inherited"]
                with running.client() as client:
                    arm(client)
                    assert all(servo["torque"] for servo in virtual.servos())
                    assert opening_time(virtual, running, number) <= WITHIN
                assert not any(servo["torque"] for servo in virtual.servos())
        with daemon(virtual, tmp_path) as running:
            running.reach(state="connected", supply_relay="closed", stop_button="released")
            with running.client() as client:
                arm(client)
                virtual.order(fault="button", pressed=True)
                running.reach(state="estop", stop_button="pressed", supply_relay="open")
                virtual.order(fault="button", plugged=False)
                running.reach(state="estop", stop_button="unplugged")
                virtual.order(fault="button", pressed=False, plugged=True)
                running.reach(stop_button="released")
                reset(client)
            running.reach(state="connected", supply_relay="closed")
            child = power_process(running)
            os.kill(child, signal.SIGKILL)
            until(lambda: power_process(running) not in (0, child), 10.0, "a new process")
            wait_closed(virtual)
            assert running.end() == 0
        assert not power(virtual)["closed"], "a daemon that ended leaves the relay closed"


def reset(client: Client) -> None:
    """Reset as soon as torque counts as off: some servos may not have confirmed it before the supply went."""

    def attempt() -> bool:
        with suppress(CallError):
            client.call("Reset")
            return True
        return False

    until(attempt, 5.0, "the reset")


def power_process(running: Daemon) -> int:
    """Process id of the power process of a daemon; 0: there is none."""
    pid = running.process.pid
    for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
        with suppress(FileNotFoundError):  # it has just ended
            if b"twind.power" in Path(f"/proc/{child}/cmdline").read_bytes():
                return int(child)
    return 0
