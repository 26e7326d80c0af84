"""A humanoid of 31 PRO servos on four ports: armed, moved, left by its daemon, unplugged."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.support.daemon_rig import Rig
from tests.support.pro_humanoid import PORTS, pro_humanoid
from twind import link
from twind.robot.modes import Mode
from twind.robot.trajectory import Trajectory

COUNT = sum(map(len, PORTS.values()))


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    made = Rig(str(pro_humanoid(tmp_path)))
    yield made
    made.close()


def move(rig: Rig, angle: float) -> None:
    """All joints to one angle, in half a second."""
    rows = np.full((1, COUNT), angle)
    whole = np.ones(COUNT, np.bool_)
    ticket = rig.submit(Trajectory(np.array([0.5]), rows, whole, np.zeros_like(rows)))
    rig.seconds(0.6)
    assert [reply.error for reply in rig.replies(ticket)] == [None]


def tripped(rig: Rig) -> list[bool]:
    return [bool(each["tripped"]) for bus in rig.virtual.values() for each in bus.truth(rig.clock.now())]


@pytest.mark.slow
def test_31_servos_follow_stop_without_their_daemon_and_stay_where_they_are_through_a_replug(
    rig: Rig,
) -> None:
    rig.arm()
    move(rig, 0.05)
    assert np.abs(rig.truth - 0.05).max() < 0.001
    last = rig.truth
    rig.clock.sleep_until(rig.clock.now() + 0.5)  # no tick: the daemon is dead
    assert np.abs(rig.truth - last).max() < 0.001
    assert tripped(rig) == [True] * COUNT
    rig.close()
    rig.front = rig.new_front()
    rig.loop = rig.born(Mode.LIVE)
    rig.arm()
    assert tripped(rig) == [False] * COUNT
    rig.virtual["left_arm"].faults.unplug()
    rig.ticks(10)
    assert rig.loop.condition.state == "fault"
    rig.virtual["left_arm"].faults.replug()
    rig.seconds(0.5)
    assert np.abs(rig.truth - last).max() < 0.001
    for order in (link.Disarm, link.Reset, link.AcquireLease, link.Arm):
        assert rig.call(order).error is None
    move(rig, 0.0)
    assert np.abs(rig.truth).max() < 0.001
