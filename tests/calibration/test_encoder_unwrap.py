"""A hand-moved joint is followed over the seam of its encoder, or said to be lost; never guessed."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.config.calibration_file import seam_margin, turn_band
from twind_calibration.calibrating.encoder_unwrap import (
    DWELL,
    FAST,
    FASTEST,
    GAP,
    QUARTER,
    EncoderSample,
    UnwrappedEncoder,
    find_gap_reason,
    framed,
    on_turn,
    shortest,
)
from twind_calibration.calibrating.joint_capture import capture

TURN = 4096
PERIOD = 0.010
quick = st.integers(-int(QUARTER * TURN), int(QUARTER * TURN))  # per reading
paths = st.lists(quick, min_size=1, max_size=120)


def on_wire(true: int, seam: int, turns: int, *, one_turn: bool) -> int:
    """Count that a servo reports: after a power-up within one turn, else continued."""
    return (true - seam) % TURN + seam if one_turn else true + turns * TURN


@given(paths, st.integers(-9000, 9000), st.sampled_from([0, -512, 700]), st.integers(-3, 3), st.booleans())
def test_the_travel_is_the_true_one_from_every_start_turn_over_every_seam(
    steps: list[int], start: int, seam: int, turns: int, one_turn: bool
) -> None:
    track = UnwrappedEncoder(TURN)
    place = start
    went = [start]
    assert track.take(EncoderSample(0.0, on_wire(place, seam, turns, one_turn=one_turn))) == ""
    for number, step in enumerate(steps, 1):
        place += step
        went.append(place)
        assert (
            track.take(EncoderSample(number * PERIOD, on_wire(place, seam, turns, one_turn=one_turn))) == ""
        )
    assert track.span == max(went) - min(went)
    low, high = framed(track.low, track.high, 0, TURN)
    assert (low - min(went)) % TURN == 0 and high - low == max(went) - min(went)
    assert 0 <= (low + high) // 2 < TURN  # the same name of the travel whatever turn it was told on


@given(st.integers(-TURN, 2 * TURN), st.integers(200, TURN - 1))
def test_two_sweeps_of_one_joint_have_one_frame(low: int, span: int) -> None:
    frames = {framed(low + turns * TURN, low + span + turns * TURN, 0, TURN) for turns in range(-3, 4)}
    assert len(frames) == 1


@given(st.integers(-9000, 9000), st.integers(-4, 4))
def test_exactly_one_turn_of_a_reading_is_in_the_band(ticks: int, turns: int) -> None:
    band = turn_band((1986, 3464), TURN)
    chosen = on_turn(ticks + turns * TURN, band)
    assert band[0] <= chosen < band[1] and (chosen - ticks) % TURN == 0
    assert chosen == on_turn(ticks, band)


@given(st.integers(-100_000, 100_000), st.sampled_from([4096, 16384, 501_923 * 2]))
def test_the_shortest_step_is_within_half_a_turn_and_the_same_but_for_turns(step: int, turn: int) -> None:
    short = shortest(step, turn)
    assert -turn // 2 < short <= turn // 2 and (short - step) % turn == 0


@given(st.integers(int(QUARTER * TURN) + 1, TURN // 2 - 1), st.sampled_from([1, -1]))
def test_a_step_over_a_quarter_turn_begins_anew(step: int, way: int) -> None:
    track = UnwrappedEncoder(TURN)
    for number in range(20):
        track.take(EncoderSample(number * PERIOD, 1000 + 40 * number))
    why = track.take(EncoderSample(20 * PERIOD, (1000 + 40 * 19 + way * step) % TURN))
    assert "turns between two readings" in why
    assert track.span == 0


@given(
    st.lists(st.integers(-60, 60), min_size=3, max_size=30),
    st.integers(1, 60),
    st.floats(-0.99 * FASTEST, 0.99 * FASTEST),
)
def test_a_gap_in_the_readings_at_hand_speed_is_reported_or_has_no_effect(
    steps: list[int], gap: int, speed: float
) -> None:
    track = UnwrappedEncoder(TURN)
    place = 2000
    for number, step in enumerate([0, 40, *steps]):
        place += step
        track.take(EncoderSample(number * PERIOD, place % TURN))
    before = track.place
    missed = round(speed * TURN * gap * PERIOD)
    after = EncoderSample((len(steps) + 1 + gap) * PERIOD, (place + missed) % TURN)
    if not track.take(after):
        assert track.place - before == missed


@pytest.mark.parametrize(
    ("step", "gap", "speed", "is_lost"),
    [
        (QUARTER * TURN, 0.01, 0.0, False),
        (QUARTER * TURN + 1, 0.01, 0.0, True),
        (FAST * TURN + 1, GAP, 0.0, False),
        (FAST * TURN + 1, GAP + 1e-3, 0.0, True),
        (FAST * TURN, GAP + 1e-3, 0.0, False),
        (0, GAP + 1e-3, FAST * TURN / GAP, True),
        (0, 0.2, 0.0, False),
        (0, 1.0 / FASTEST, 0.0, True),
    ],
)
def test_the_edges_of_what_counts_as_lost(step: float, gap: float, speed: float, is_lost: bool) -> None:
    assert bool(find_gap_reason(int(step), gap, speed, TURN)) is is_lost


def test_a_repeated_old_reading_is_ignored() -> None:
    track = UnwrappedEncoder(TURN)
    for sample in (
        EncoderSample(1.0, 100),
        EncoderSample(1.01, 130),
        EncoderSample(1.01, 130),
        EncoderSample(0.5, 4000),
    ):
        assert track.take(sample) == ""
    assert (track.low, track.high, track.place) == (100, 130, 130)


def test_a_joint_that_never_moved_begins_anew_in_silence() -> None:
    track = UnwrappedEncoder(TURN)
    track.take(EncoderSample(0.0, 100))
    assert track.take(EncoderSample(5.0, 102)) == ""
    assert track.span == 0


def rested_after(dwell: float, *, further: int = 0) -> tuple[bool, bool]:
    """A joint that goes from 1000 up to 2000, rests, comes home, rests, and perhaps goes further."""
    track = UnwrappedEncoder(TURN)
    time = 0.0

    def go(to: int) -> None:
        nonlocal time
        way = 1 if to > track.place else -1
        for place in range(track.place, to, way * 20):
            time += PERIOD
            track.take(EncoderSample(time, place))
        track.take(EncoderSample(time + PERIOD, to))
        time += PERIOD

    def stay() -> None:
        nonlocal time
        at = track.place
        for number in range(round(dwell / PERIOD)):
            time += PERIOD
            track.take(EncoderSample(time, at - number % 2))

    track.take(EncoderSample(0.0, 1500))
    for end in (2000, 1000):
        go(end)
        stay()
    if further:
        go(1000 - further)
    return track.rested(20)


def test_both_ends_count_only_once_rested_at_and_a_further_one_must_be_rested_at_again() -> None:
    assert rested_after(DWELL + 0.1) == (True, True)
    assert rested_after(DWELL - 0.1) == (False, False)
    assert rested_after(DWELL + 0.1, further=15) == (True, True)
    assert rested_after(DWELL + 0.1, further=200) == (False, True)


# ------------------------------------------------------------------------------------------- captures


@given(st.integers(-9000, 9000), st.lists(st.integers(-2, 2), min_size=50, max_size=80))
def test_a_held_joint_is_read_over_the_seam_as_anywhere(at: int, noise: list[int]) -> None:
    plain = capture([10_000 + each for each in noise], TURN)
    wrapped = capture([(at + each) % TURN for each in noise], TURN)
    assert not wrapped.wrong or "it moved" in wrapped.wrong
    assert wrapped.sigma == pytest.approx(plain.sigma)
    assert (wrapped.mean - at - (plain.mean - 10_000)) % TURN == pytest.approx(0.0, abs=1e-6) or (
        TURN - (wrapped.mean - at - (plain.mean - 10_000)) % TURN
    ) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("readings", "why"),
    [
        ([], "no reading arrived"),
        ([7] * 49, "49 readings came, 50 are needed"),
        ([-4, 4] * 25, "standard deviation"),
        ([number // 5 for number in range(50)], "it moved: +6.8 ticks"),
        ([3, -3] * 25, ""),
    ],
)
def test_an_unusable_capture_reports_the_cause(readings: list[int], why: str) -> None:
    found = capture(readings, TURN)
    assert why in found.wrong and bool(found.wrong) is bool(why)


def test_a_finer_encoder_may_waver_by_more_of_its_counts() -> None:
    readings = [-6, 6] * 25
    assert capture(readings, 4096).wrong and not capture(readings, 16384).wrong


def test_the_helpers_agree_with_the_file() -> None:
    sweep = framed(-600, 600, 0, TURN)
    assert sweep == (-600, 600) and seam_margin(sweep, TURN) == 0
    assert all(later > earlier for earlier, later in pairwise(turn_band(sweep, TURN)))
