"""Calls of one tick: a recorded budget, which a change raises knowingly or not at all.

CPU time of a tick follows the number of calls, and calls are the same on every machine. A change that needs
more raises the figure here and says in its commit what for; one that needs less lowers it.
"""

import sys
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from tests.support.contact_rig import ContactRig
from tests.support.daemon_rig import Rig
from tests.support.tick_calls import TickCalls, count_calls
from twind.loop.tick.assembly import gravity_compensation
from twind.robot.modes import Motion
from twind.robot.trajectory import Trajectory

# h24 on one bus at 100 Hz, Python 3.11. Commit 2d1dfd9, moving: 688 and 479.
BUDGET = {
    "connected": TickCalls(359, 238),
    "armed at rest": TickCalls(346, 247),
    "moving": TickCalls(374, 269),
    "moving, compensated": TickCalls(407, 289),
}
OBSERVER = TickCalls(10, 8)  # more with an observer of external torque; measured 8.7 and 7.4
SLACK = 0.03  # share: rounds of different length meet differently
MOTION = 5.0  # s

pytestmark = pytest.mark.skipif(
    sys.version_info[:2] != (3, 11), reason="the budget is of Python 3.11: others inline other calls"
)


@pytest.fixture
def rig() -> Iterator[Rig]:
    made = Rig()
    yield made
    made.close()


def move_all_joints(rig: Rig) -> None:
    """Begin a motion of all joints that lasts longer than a count."""
    start = rig.loop.robot.measured.position
    time = np.arange(1.0, MOTION + 1.0)
    rows = start + 0.05 * (time % 2)[:, np.newaxis]
    rows[-1] = rows[-2]
    path = Trajectory(time, rows, np.ones(len(start), np.bool_), np.zeros_like(rows))
    rig.submit(path, more=True)  # an open call keeps the lease
    rig.seconds(0.5)


@pytest.mark.parametrize("phase", BUDGET)
def test_a_tick_makes_as_many_calls_as_recorded(rig: Rig, phase: str) -> None:
    rig.connect()
    if phase != "connected":
        rig.arm()
    if phase == "moving, compensated":
        described = replace(rig.robot, compensate_gravity=True)
        rig.loop.robot.compensation = gravity_compensation(described, rig.one.binding, rig.loop.parts.guard)
    if phase.startswith("moving"):
        move_all_joints(rig)
    rig.seconds(0.5)
    calls, most = count_calls(rig)
    motions = {"connected": Motion.IDLE, "armed at rest": Motion.HOLDING}
    assert rig.loop.executor.motion is motions.get(phase, Motion.ACTIVE)
    for kind, count, budget in zip(TickCalls._fields, calls, BUDGET[phase], strict=True):
        assert count <= (1 + SLACK) * budget, f"{phase}: {count:.0f} {kind} calls, budget {budget}\n{most}"
        assert count >= (1 - 2 * SLACK) * budget, (
            f"{phase}: {count:.0f} {kind} calls, lower the budget {budget}"
        )


def test_observer_of_external_torque_adds_few_calls() -> None:
    rig = ContactRig()
    try:
        rig.arm()
        rig.lease()
        rig.dance(MOTION, 0)
        rig.seconds(0.5)
        observed, _ = count_calls(rig)
        assert not rig.events("CONTACT")
        rig.loop.robot.observer = None
        bare, most = count_calls(rig)
        assert rig.loop.executor.motion is Motion.ACTIVE
    finally:
        rig.close()
    assert observed.python - bare.python <= OBSERVER.python, most
    assert observed.c - bare.c <= OBSERVER.c, most
