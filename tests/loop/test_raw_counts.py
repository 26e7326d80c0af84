"""Counts as received: what is kept of an actuator that does not reply, or does not report its effort."""

from math import inf

import numpy as np
import pytest

from twind.loop.bus.raw_counts import RawCounts
from twind_drivers.bus import BusSample

PLACES = slice(1, 4)


def reply(position: list[int], replied: list[bool], reported: list[bool] | None, at: float) -> BusSample:
    count = np.array(position, np.int64)
    return BusSample(
        sent=at - 0.002,
        received=at,
        position=count,
        velocity=np.zeros(3, np.int64),
        effort=10 * count,
        error=np.zeros(3, np.uint8),
        heard=np.array(replied),
        asked=np.ones(3, np.bool_),
        discarded=0,
        foreign=0,
        effort_told=None if reported is None else np.array(reported),
    )


def test_before_the_first_reply_nothing_is_known() -> None:
    raw = RawCounts(4)
    assert raw.age(5.0).tolist() == [inf] * 4
    assert np.isnan(raw.effort).all()


@pytest.mark.parametrize("reported", [None, [True, False, True]])
def test_a_whole_reply_replaces_counts_efforts_and_times(reported: list[bool] | None) -> None:
    raw = RawCounts(4)
    for at in (1.0, 2.0):
        raw.take(PLACES, reply([int(at), 2, 3], [True] * 3, reported, at))
        assert raw.ticks.tolist() == [0, int(at), 2, 3]
        effort = [np.nan, 10.0 * at, 20.0 if reported is None else np.nan, 30.0]
        assert raw.effort == pytest.approx(effort, nan_ok=True)
        assert raw.age(3.0).tolist() == [inf, 3.0 - at, 3.0 - at, 3.0 - at]


@pytest.mark.parametrize("reported", [None, [True, False, False]])
def test_an_actuator_that_does_not_reply_keeps_its_last_values(reported: list[bool] | None) -> None:
    raw = RawCounts(4)
    raw.take(PLACES, reply([1, 2, 3], [True] * 3, None, 1.0))
    raw.take(PLACES, reply([7, 8, 0], [True, True, False], reported, 2.0))
    assert raw.ticks.tolist() == [0, 7, 8, 3]
    assert raw.effort == pytest.approx(
        [np.nan, 70.0, 80.0 if reported is None else np.nan, 30.0], nan_ok=True
    )
    assert raw.age(3.0).tolist() == [inf, 1.0, 1.0, 2.0]
