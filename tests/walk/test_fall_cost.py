"""Calls that fall detection adds to a tick: few while the robot stands or walks, more while it leans."""

from contextlib import closing

import pytest

from tests.support.fall_rig import FallRig
from tests.support.hand_rig import Hands
from tests.support.tick_calls import TickCalls, count_calls
from twind.robot.fall_settings import FallReaction

# by tilt, rad: calls more than without `fall`, Python 3.11
GROWTH = {0.0: TickCalls(3, 5), 0.15: TickCalls(22, 31)}
SLACK = 3.0  # calls: rounds of different length meet differently


def calls(reaction: FallReaction | None, tilt: float) -> TickCalls:
    with closing(FallRig(reaction)) as rig:
        rig.stand()
        assert rig.body is not None
        hands: object = Hands(rig.body, "torso", lambda time: (0.1, tilt, 0.0))
        rig.body.crane = hands  # type: ignore[assignment]
        rig.seconds(1.0)
        found, most = count_calls(rig)
        assert rig.trips == []
        print(most)
        return found


@pytest.mark.parametrize("tilt", GROWTH)
def test_a_tick_grows_by_as_many_calls_as_recorded(tilt: float) -> None:
    without = calls(None, tilt)
    with_falls = calls(FallReaction.HOLD, tilt)
    for kind, before, after, grown in zip(TickCalls._fields, without, with_falls, GROWTH[tilt], strict=True):
        print(f"tilt {tilt:g}: {before:.1f} {kind} calls, {after - before:.1f} more")
        assert after - before == pytest.approx(grown, abs=SLACK), kind
