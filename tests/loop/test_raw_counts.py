"""Raw counts are kept as the device sent them, and none is made up."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.loop.bus.raw_counts import RawCounts
from twind_drivers.bus import BusSample

COUNT = 3
ANSWERS = st.lists(
    st.tuples(st.integers(-(2**31), 2**31 - 1), st.integers(-2047, 2047), st.booleans()),
    min_size=COUNT,
    max_size=COUNT,
)


def sample(
    answers: list[tuple[int, int, bool]], at: float, effort_fresh: list[bool] | None = None
) -> BusSample:
    """Answers of one bus; who was not heard has zeros, as a driver leaves them."""
    heard = np.array([each[2] for each in answers])
    return BusSample(
        sent=at,
        received=at + 0.002,
        position=np.where(heard, [each[0] for each in answers], 0),
        velocity=np.zeros(COUNT, np.int64),
        effort=np.where(heard, [each[1] for each in answers], 0),
        error=np.zeros(COUNT, np.uint8),
        heard=heard,
        asked=np.ones(COUNT, np.bool_),
        discarded=0,
        foreign=0,
        effort_told=None if effort_fresh is None else np.array(effort_fresh) & heard,
    )


@given(st.lists(ANSWERS, min_size=1, max_size=6))
def test_each_actuator_has_its_own_last_answer_and_the_age_of_that(answers: list) -> None:
    raw = RawCounts(COUNT)
    for number, each in enumerate(answers):
        raw.take(slice(0, COUNT), sample(each, float(number)))
    for place in range(COUNT):
        said = [(number, each[place]) for number, each in enumerate(answers) if each[place][2]]
        if not said:
            assert np.isinf(raw.age(9.0)[place])
            assert np.isnan(raw.effort[place])
            continue
        number, (ticks, effort, _) = said[-1]
        assert (raw.ticks[place], raw.effort[place]) == (ticks, effort)
        assert raw.age(9.0)[place] == 9.0 - (number + 0.002)


def test_two_buses_fill_their_own_places_in_any_order() -> None:
    raw = RawCounts(2 * COUNT)
    raw.take(np.array([5, 0, 3]), sample([(50, 5, True), (-1, 6, True), (4097, 7, True)], 1.0))
    raw.take(np.array([1, 2, 4]), sample([(10, 1, True), (0, 0, False), (40, 4, True)], 2.0))
    assert raw.ticks[[5, 0, 3, 1, 4]].tolist() == [50, -1, 4097, 10, 40]
    assert np.isinf(raw.age(3.0)).tolist() == [False, False, True, False, False, False]


def test_an_unreported_effort_is_unknown_and_not_zero() -> None:
    raw = RawCounts(COUNT)
    raw.take(slice(0, COUNT), sample([(1, 0, True)] * COUNT, 1.0, effort_fresh=[True, False, True]))
    assert np.isnan(raw.effort).tolist() == [False, True, False]
    assert raw.ticks.tolist() == [1, 1, 1]


@pytest.mark.parametrize("reported", [None, [True, False, True]])
def test_a_whole_answer_replaces_counts_efforts_and_times(reported: list[bool] | None) -> None:
    raw = RawCounts(COUNT)
    for at in (1.0, 2.0):
        raw.take(slice(0, COUNT), sample([(int(at), 10, True), (2, 20, True), (3, 30, True)], at, reported))
        assert raw.ticks.tolist() == [int(at), 2, 3]
        effort = [10.0, 20.0 if reported is None else np.nan, 30.0]
        assert raw.effort == pytest.approx(effort, nan_ok=True)
        assert raw.age(3.0) == pytest.approx([3.0 - at - 0.002] * COUNT)


@pytest.mark.parametrize("reported", [None, [True, False, False]])
def test_an_actuator_that_does_not_answer_keeps_its_last_values(reported: list[bool] | None) -> None:
    raw = RawCounts(COUNT)
    raw.take(slice(0, COUNT), sample([(1, 10, True), (2, 20, True), (3, 30, True)], 1.0))
    raw.take(slice(0, COUNT), sample([(7, 70, True), (8, 80, True), (0, 0, False)], 2.0, reported))
    assert raw.ticks.tolist() == [7, 8, 3]
    assert raw.effort == pytest.approx([70.0, 80.0 if reported is None else np.nan, 30.0], nan_ok=True)
    assert raw.age(3.0) == pytest.approx([0.998, 0.998, 1.998])


def test_before_the_first_answer_nothing_is_known() -> None:
    raw = RawCounts(COUNT)
    assert raw.age(5.0).tolist() == [np.inf] * COUNT
    assert np.isnan(raw.effort).all()
