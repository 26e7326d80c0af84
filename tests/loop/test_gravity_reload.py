"""Compensation of gravity after a reload is that of a daemon that starts with the same files."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.body_rig import written_robot
from tests.support.daemon_rig import Rig
from twind.loop.tick.assembly import gravity_compensation
from twind.robot.arrays import Floats
from twind.robot.event_codes import EventCode
from twind.robot.modes import Mode
from twind.robot.trajectory import Reference

ON = ("loop: {", "loop: {compensate_gravity: true, ")
PERIOD = 0.01  # s
ARRIVED = 8.0  # s: an offset approaches its bound ever more slowly


@pytest.fixture
def rig(tmp_path: Path) -> Any:
    """so101 in mode sim, which holds its rest pose with the whole offset."""
    made = Rig(written_robot(tmp_path, "so101", ON), Mode.SIM)
    made.seconds(2.0)
    yield made
    made.close()


def offset(rig: Rig) -> Floats:
    """Return the offset in the last goal that left (n,), rad."""
    robot = rig.loop.robot
    assert robot.written is not None and robot.commanded is not None
    return robot.written - robot.commanded


def offset_after_start(rig: Rig) -> Floats:
    """Return the offset of a new daemon with the files in force, in the same pose."""
    loop = rig.loop
    bound = loop.robot.bound
    fresh = gravity_compensation(bound.file, bound.binding, loop.parts.guard)
    assert fresh is not None and loop.robot.commanded is not None
    pose = loop.robot.commanded
    none = np.zeros(len(pose))
    written = pose
    for _ in range(round(ARRIVED / PERIOD)):
        goal = fresh.compensate(Reference(pose, none, none), written, loop.robot.limits, PERIOD, active=True)
        written = goal.position
    return written - pose


def change_gain(rig: Rig, p: int) -> None:
    """Set the P gain of all servos by a reload, and wait until offsets have followed."""
    kinds = {joint.type.name for joint in rig.robot.joints}
    assert rig.adopt({f"types.{kind}.gains": {"p": p, "i": 0, "d": 32} for kind in kinds}).error is None
    rig.seconds(ARRIVED)


@pytest.mark.parametrize("p", [8, 64])
def test_offsets_after_a_reload_of_gains_are_those_of_a_restart(rig: Rig, p: int) -> None:
    before = offset(rig)
    change_gain(rig, p)
    assert np.abs(before).max() > 0.02
    assert np.abs(offset(rig) - before).max() > 0.01
    assert offset(rig) == pytest.approx(offset_after_start(rig), abs=1e-9)


def test_without_a_gain_there_is_no_offset_and_it_comes_back_with_the_gain(rig: Rig) -> None:
    change_gain(rig, 32)
    before = offset(rig)
    change_gain(rig, 0)
    assert np.array_equal(offset(rig), np.zeros(len(before)))
    change_gain(rig, 32)
    assert offset(rig) == pytest.approx(before, abs=1e-9)
    assert not rig.events(EventCode.RELOAD_REFUSED)
    assert not rig.events("INTERNAL") and not rig.events("STEP_LIMIT")
