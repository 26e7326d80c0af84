"""Exactly one of a count and its neighbouring turns fits the travel; otherwise arming is refused."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.config.calibration_file import turn_band
from twind.robot.finding import Finding, ReasonCode
from twind.robot.measured_travel import MeasuredTravel
from twind.safety.multiturn import (
    STATED_NEAR,
    StatedPlace,
    chosen,
    expected,
    inside,
    outside_travel,
    unfit,
)

WHOLE = 4096
FIRST = 1500
LAST = 2600
SLACK = 98
MANY = 1_048_575


def turns(
    first: int = FIRST, last: int = LAST, *, whole: int = WHOLE, falls: bool = False, begin: int = 0
) -> MeasuredTravel:
    """Choose the turns of one joint, in a multi-turn mode unless it `falls`."""
    numbers = {
        "whole": whole,
        "band": turn_band((first, last), whole)[0],
        "first": first,
        "last": last,
        "slack": SLACK,
        "least": 0 if falls else -MANY,
        "most": whole - 1 if falls else MANY,
        "lower": first + 20,
        "upper": last - 20,
        "begin": begin,
    }
    arrays = {name: np.array([number]) for name, number in numbers.items()}
    return MeasuredTravel(known=np.array([True]), falls=np.array([falls]), **arrays)


def refusal(raw: int, of: MeasuredTravel, *, on: bool = False) -> Finding | None:
    """Return the finding about that reading, if there is one."""
    shift = chosen(np.array([raw]), of)
    found = unfit(np.array([raw]), shift, of, np.array([on]))
    assert all(each.code is ReasonCode.CALIB_MISMATCH and each.joint == 0 for each in found)
    assert len(found) < 2
    return found[0] if found else None


def refusal_message(raw: int, of: MeasuredTravel, *, on: bool = False) -> str:
    """Return the message about that reading; empty: none."""
    found = refusal(raw, of, on=on)
    return found.message if found else ""


def numbers(raw: int, of: MeasuredTravel) -> tuple[float | None, float | None] | None:
    """Return value and bound of the finding about that reading, if there is one."""
    found = refusal(raw, of)
    return None if found is None else (found.value, found.bound)


@given(st.integers(FIRST - SLACK, LAST + SLACK), st.integers(-200, 200))
def test_a_reading_any_turns_off_is_put_right(count: int, off: int) -> None:
    of = turns()
    raw = count + off * WHOLE
    shift = chosen(np.array([raw]), of)
    assert raw + shift[0] == count
    assert refusal_message(raw, of) == ""


@given(
    st.integers(-50_000, 50_000),
    st.integers(-20_000, 20_000),
    st.integers(1, 9000),
    st.sampled_from([4096, 16384, 1_003_846]),
)
def test_exactly_one_turn_is_in_the_band_and_nothing_passes_that_is_not_alone_in_the_travel(
    raw: int, first: int, span: int, whole: int
) -> None:
    of = turns(first, first + span, whole=whole)
    shift = int(chosen(np.array([raw]), of)[0])
    count = raw + shift
    assert shift % whole == 0
    assert of.band[0] <= count < of.band[0] + whole
    if refusal_message(raw, of) == "":
        least = first - SLACK
        most = first + span + SLACK
        assert least <= count <= most
        assert not least <= count - whole <= most
        assert not least <= count + whole <= most


@pytest.mark.parametrize("beyond", [FIRST - SLACK - 1, LAST + SLACK + 1, FIRST + WHOLE // 2])
@pytest.mark.parametrize("off", [-2, 0, 1])
def test_a_reading_outside_every_turn_of_the_travel_is_reported(beyond: int, off: int) -> None:
    raw = beyond + off * WHOLE
    assert f"reads {raw}: neither that nor a turn beside it is in its travel 1402..2698" in refusal_message(
        raw, turns()
    )


def test_the_ends_that_a_limp_joint_may_hang_at_are_inside() -> None:
    for count in (FIRST - SLACK, LAST + SLACK):
        assert refusal_message(count, turns()) == ""


@pytest.mark.parametrize("raw", [0, 1500, 5595, -4000])
def test_a_travel_that_leaves_no_unique_turn_is_refused_everywhere(raw: int) -> None:
    assert "is 4096 or more" in refusal_message(raw, turns(1500, 1500 + 4096, falls=True))
    assert "both fit its travel" in refusal_message(raw, turns(1500, 1500 + 2 * 4096 - 2 * SLACK))


@given(st.integers(1, 2 * WHOLE), st.integers(-5 * WHOLE, 5 * WHOLE), st.data())
def test_a_long_travel_gives_the_true_count_or_none(span: int, first: int, data: st.DataObject) -> None:
    of = turns(first, first + span)
    true = data.draw(st.integers(first - SLACK, first + span + SLACK))
    raw = true + data.draw(st.integers(-3, 3)) * WHOLE
    shift = int(chosen(np.array([raw]), of)[0])
    if refusal_message(raw, of) == "":
        assert raw + shift == true
    middle = first + span // 2
    if span + 2 * SLACK < 2 * WHOLE - 2 and true == middle:
        assert refusal_message(raw, of) == "", "in its middle the turn is known"


@given(st.integers(1, 9 * WHOLE), st.integers(-500, 500), st.integers(-9, 9), st.data())
def test_a_known_place_gives_the_true_turn_or_none(
    span: int, off: int, wound: int, data: st.DataObject
) -> None:
    of = turns(FIRST, FIRST + span)
    true = data.draw(st.integers(FIRST, FIRST + span))
    raw = true + wound * WHOLE
    place = StatedPlace(true + off, WHOLE // 8, "an operator")
    shift = np.array([place.shift(raw, WHOLE)])
    assert raw + shift[0] == true
    assert (place.contradiction(0, raw, WHOLE) is None) == (abs(off) <= WHOLE // 8)
    on = np.array([False])
    assert not unfit(np.array([raw]), shift, of, on, np.array([True]))
    beyond = unfit(np.array([raw]), shift + (span // WHOLE + 2) * WHOLE, of, on, np.array([True]))
    assert "neither that nor a turn beside it is in its travel" in beyond[0].message


def test_a_waist_of_one_and_a_half_turns_is_known_in_its_middle_alone() -> None:
    of = turns(-1007, 5102)
    assert of.ambiguous.all() and not turns().ambiguous.any()
    assert refusal_message(2048, of) == ""
    for raw in (1000, 3200, -1007, 5102):
        assert "both fit its travel -1105..5200" in refusal_message(raw, of)


@pytest.mark.parametrize(
    ("raw", "other"),
    [
        (1000, 5096),
        (3200, -896),
        (2991, -1105),
        (2990, 7086),
        (2065, 6161),
        (2064, None),
        (2031, None),
        (2030, 6126),
    ],
)
def test_the_other_turn_that_fits_is_named(raw: int, other: int | None) -> None:
    """Both ends of a travel of -1007..5102 are 1024 further for a joint whose turn is chosen."""
    of = turns(-1007, 5102)
    assert numbers(raw, of) == (None if other is None else (raw, other))


@pytest.mark.parametrize(("span", "known_there"), [(6142, True), (6143, False)])
def test_the_remedy_names_the_middle_only_where_the_turn_is_known_there(span: int, known_there: bool) -> None:
    of = turns(-1007, -1007 + span)
    middle = refusal_message(-1007 + span // 2, of)
    assert (middle == "") == known_there
    end = refusal_message(-1007, of)
    assert ("move it to its middle by hand" in end) == known_there
    assert "`twindctl calibrate turn`" in end


def test_a_position_near_both_ends_of_a_travel_of_nearly_a_turn_is_ambiguous() -> None:
    of = turns(0, 4050)
    assert refusal_message(2000, of) == ""
    assert refusal_message(60, of) == ""
    for raw in (20, 4040, 4090, -40):
        assert "both fit its travel -98..4148" in refusal_message(raw, of)


@pytest.mark.parametrize(("raw", "fine"), [(2000, True), (2000 + 4096, True), (2000 - 2 * 4096, False)])
def test_a_turn_on_which_its_goals_cannot_be_sent_is_refused(raw: int, fine: bool) -> None:
    of = replace(turns(), least=np.array([-4096]), most=np.array([8191]))
    message = refusal_message(raw, of)
    assert (message == "") == fine
    if not fine:
        assert "reads -6192, +2 turns from where it was calibrated" in message
        assert "its goals there, -6672..-5612, are outside -4096..8191" in message


@pytest.mark.parametrize(
    ("raw", "least", "most", "expected"),
    [
        (2000 - 2 * WHOLE, -6672, MANY, None),
        (2000 - 2 * WHOLE, -6671, MANY, (-6672, -6671)),
        (2000 + 2 * WHOLE, -MANY, 10772, None),
        (2000 + 2 * WHOLE, -MANY, 10771, (10772, 10771)),
        (2000, 1520, 2579, (2580, 2579)),
        (2000, 1521, 2579, (1520, 1521)),
    ],
)
def test_a_goal_that_cannot_be_sent_is_named_with_the_end_of_its_register(
    raw: int, least: int, most: int, expected: tuple[int, int] | None
) -> None:
    assert numbers(raw, replace(turns(), least=np.array([least]), most=np.array([most]))) == expected


def test_a_position_outside_its_travel_is_named_with_the_nearer_end() -> None:
    assert numbers(FIRST - SLACK - 1, turns()) == (FIRST - SLACK - 1, FIRST - SLACK)
    assert numbers(LAST + SLACK + 1, turns()) == (LAST + SLACK + 1, LAST + SLACK)
    assert numbers(0, turns(1500, 1500 + WHOLE, falls=True)) == (WHOLE + 2 * SLACK, WHOLE)


@pytest.mark.parametrize("wound", [-2, 0, 3])
def test_a_stated_place_is_believed_within_an_eighth_of_a_turn_on_any_turn(wound: int) -> None:
    near = WHOLE // STATED_NEAR
    assert near == 512
    place = StatedPlace(2000, near, "an operator")
    for off in (-near, near):
        assert place.contradiction(3, 2000 + off + wound * WHOLE, WHOLE) is None
    for off in (-near - 1, near + 1):
        found = place.contradiction(3, 2000 + off + wound * WHOLE, WHOLE)
        assert found is not None
        assert (found.code, found.joint) == (ReasonCode.CALIB_MISMATCH, 3)
        assert (found.value, found.bound) == (2000 + off, 2000)
        assert "where an operator puts it" in found.message


def test_position_mode_a_turn_off_is_refused_before_torque_and_with_it() -> None:
    of = turns(falls=True)
    for on in (False, True):
        assert refusal_message(2000, of, on=on) == ""
        for off in (-2, -1, 1):
            message = refusal_message(2000 + off * 4096, of, on=on)
            assert f"{-off:+d} turns from where it was calibrated" in message
            assert "switch its power off and on" in message
            assert ("`twindctl disarm`" in message) == on


@given(st.integers(-100_000, 100_000), st.integers(-1024, 1024))
def test_at_torque_on_position_mode_reads_one_turn_and_its_offset(raw: int, offset: int) -> None:
    (then,) = expected(np.array([raw]), turns(falls=True, begin=offset))
    assert offset <= then < offset + WHOLE
    assert (then - raw) % WHOLE == 0
    assert expected(np.array([raw]), turns(begin=offset)).tolist() == [raw]


def test_the_worked_example_of_a_count_that_falls_past_its_own_goal() -> None:
    """ROBOTIS forum 7814: offset -512, 3700 without torque, -396 with it."""
    assert expected(np.array([3700]), turns(falls=True, begin=-512)).tolist() == [-396]


def test_a_joint_that_leaves_its_travel_is_reported_and_keeps_its_turn() -> None:
    shift = np.array([4096])
    told = np.array([True])
    assert not outside_travel(np.array([2000 - 4096]), shift, turns(), told)
    assert not outside_travel(np.array([0]), shift, turns(), ~told)
    [finding] = outside_travel(np.array([FIRST - SLACK - 1 - 4096]), shift, turns(), told)
    assert (finding.value, finding.bound) == (FIRST - SLACK - 1, FIRST - SLACK)
    assert "out of its travel 1402..2698, in which it was identified" in finding.message
    [finding] = outside_travel(np.array([LAST + SLACK + 1 - 4096]), shift, turns(), told)
    assert (finding.value, finding.bound) == (LAST + SLACK + 1, LAST + SLACK)


def test_a_joint_without_a_measured_travel_is_not_checked_and_keeps_its_count() -> None:
    of = replace(turns(), known=np.array([False]), whole=np.array([0]))
    for raw in (-100_000, 0, 100_000):
        assert chosen(np.array([raw]), of).tolist() == [0]
        assert inside(np.array([raw]), of).all()
        assert refusal_message(raw, of) == ""
