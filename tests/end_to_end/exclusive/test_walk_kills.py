"""SIGKILL of client, front process and loop while a robot steps: who stops it, and that torque stays.

Whether it keeps standing depends on the phase of its step: `tests/walk/test_interrupted_walk.py` counts.
"""

import os
import signal
import time

import pytest

from tests.support.processes import Daemon, Virtual, arm, daemon, robot, twindctl, until

STANDING = 0.35  # m of the base above the floor
STEPPING = 1.5  # s
TRIP = 0.120  # s from the last packet to the trip of a watchdog

pytestmark = pytest.mark.slow


def height(virtual: Virtual) -> float:
    body = virtual.order(query="state")["body"]
    return 0.0 if body["held"] else float(body["position"][2])


def shows_torque(virtual: Virtual) -> bool:
    return all(servo["torque"] for servo in virtual.servos())


def kill(victim: str, running: Daemon, walker: int) -> None:
    pids = {"client": walker, "front": running.front(), "loop": running.process.pid}
    os.kill(pids[victim], signal.SIGKILL)


@pytest.mark.parametrize("victim", ["client", "front", "loop"])
def test_torque_stays_and_motion_ends_whatever_is_killed_while_it_steps(victim: str) -> None:
    with robot("h24-standing") as (virtual, folder), daemon(virtual, folder) as running:
        running.reach(state="connected")
        with running.client() as client:
            arm(client)
        until(lambda: height(virtual) > STANDING, 10.0, "the hands let go")
        with twindctl("--socket", str(running.sockets), "walk", "--turn", "0.1", "--take") as walker:
            running.reach(motion="streaming")
            time.sleep(STEPPING)
            running.reach(seconds=2.0, motion="streaming")
            before = height(virtual)
            kill(victim, running, walker.pid)
            if victim == "loop":
                running.process.wait(10)
                time.sleep(0.3)
                assert shows_torque(virtual)
                assert max(servo["trip_delay"] for servo in virtual.servos()) <= TRIP
            else:
                running.reach(seconds=10.0, motion="holding", lease=None)
                assert shows_torque(virtual)
            time.sleep(3.0)
            print(f"{victim} killed: base at {before:.2f} m, 3 s later at {height(virtual):.2f} m")
            assert shows_torque(virtual)
