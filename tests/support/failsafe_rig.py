"""A robot whose daemon was given up, and runs of the fail-safe on it: real bytes under a fake clock."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from tests.support.daemon_rig import Rig
from twind.config.robot_file import load_robot
from twind.loop.procedures import failsafe
from twind.loop.procedures.failsafe import FailsafeRun
from twind.robot.modes import Mode

RAISED = {"r_shoulder_pitch": -0.8, "head_yaw": 0.4}


@contextmanager
def given_up(
    robot: str = "h24", *, support: str = "gantry", mode: Mode = Mode.LIVE, killed: bool = True, **more: Any
) -> Iterator[Rig]:
    """A robot with an arm raised and torque on, its daemon gone; a new loop before its first tick.

    `killed`: it was armed, and its watchdogs have tripped since. Else torque is just found on.
    """
    start = {**load_robot(robot).poses["rest"], **RAISED, **more}
    rig = Rig(robot, start=start, support=support, rate_hz=50.0)
    if killed:
        rig.arm()
        assert rig.loop.torque.armed
        # what the kernel does for a process that was killed
        rig.loop.hardware.access(read=False, write=False)
        rig.front.end(0.0)
        rig.front = rig.new_front()
    else:
        for bus in rig.virtual.values():
            for row in range(len(bus.servos["torque_enable"])):
                bus.servos.torque(row, True)
    rig.clock.sleep_until(rig.clock.now() + 0.5)
    rig.advance_servos()
    rig.loop = rig.born(mode)
    rig.news.clear()
    try:
        yield rig
    finally:
        rig.close()


def failsafe_of(rig: Rig) -> FailsafeRun:
    """A run on this rig's robot."""
    loop = rig.loop
    return FailsafeRun(loop, loop.identity, loop.commands.release, loop.parts.notifier)


def run(rig: Rig, seconds: float = failsafe.LONGEST) -> FailsafeRun:
    """Until it has ended."""
    safe = failsafe_of(rig)
    safe.begin()
    for _ in range(round(seconds / rig.loop.robot.period)):
        if rig.loop.condition.finished:
            return safe
        rig.ticks(1)
    raise AssertionError(f"not ended: {[event.message for event in rig.events()]}")


def torque(rig: Rig) -> np.ndarray:
    return rig.register("torque_enable")


def off_rest(rig: Rig) -> float:
    return float(np.abs(rig.truth - rig.loop.robot.rest).max())
