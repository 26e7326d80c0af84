"""A walk whose client, or whose daemon, is gone at any phase of a step: how often the robot falls.

`pytest -m campaign tests/walk/test_interrupted_walk.py -s` prints the figures of docs/safety.md.
"""

from contextlib import closing

import pytest

from tests.support.fall_rig import PERIOD, FallRig
from twind.robot.fall_settings import FallReaction
from twind.robot.modes import Motion

pytestmark = pytest.mark.campaign

FORWARD = (0.12, 0.0, 0.0)  # m/s
BEGIN = 3.0  # s, when it walks at full speed
STEPS = 1.6  # s, of a step of each foot
PHASES = 20
AFTER = 300  # ticks that it is watched


def interrupted(phase: int, *, daemon: bool) -> tuple[bool, bool]:
    """Return whether it fell, and whether a fall was detected. `daemon`: the daemon dies, not its client."""
    with closing(FallRig(FallReaction.HOLD)) as rig:
        rig.stand()
        assert rig.follow(BEGIN + STEPS * phase / PHASES, FORWARD)
        assert rig.body is not None
        if daemon:  # the servos keep their last goals
            for _ in range(AFTER):
                rig.clock.time += PERIOD
                rig.body.advance(rig.clock.now())
            return rig.fallen, False
        rig.ticks(AFTER)
        assert rig.loop.executor.motion is Motion.HOLDING
        assert rig.loop.torque.armed
        return rig.fallen, bool(rig.trips)


@pytest.mark.parametrize("daemon", [False, True])
def test_torque_holds_a_robot_whose_walk_ends_at_once_but_not_on_every_foot(daemon: bool) -> None:
    outcomes = [interrupted(phase, daemon=daemon) for phase in range(PHASES)]
    fell = sum(each for each, _ in outcomes)
    detected = sum(each for _, each in outcomes)
    places = [phase / PHASES * 2 for phase, (each, _) in enumerate(outcomes) if each]
    print(
        f"\n{'daemon' if daemon else 'client'} gone: {fell} of {PHASES} fell, {detected} detected, {places}"
    )
    assert daemon or detected == fell
