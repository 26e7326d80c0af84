"""A hand's path becomes few points that stay within a bound of every sample."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from twind.motion.hand_path import BLEND, RAMP, REST, HandPath, deviation, excess, simplify
from twind.robot.arrays import Floats

TICK = 2.0 * np.pi / 4096  # rad


@st.composite
def paths(draw: st.DrawFn) -> HandPath:
    """Any samples at all: with gaps, jumps and stays."""
    count = draw(st.integers(2, 80))
    steps = draw(arrays(np.float64, count, elements=st.floats(0.005, 0.1)))
    rows = draw(arrays(np.float64, (count, 2), elements=st.floats(-2.0, 2.0)))
    smooth = draw(st.booleans())
    return HandPath(np.cumsum(steps), np.cumsum(rows * 0.01, axis=0) if smooth else rows)


def guided(seconds: float = 6.0) -> HandPath:
    """Three joints guided smoothly from rest to rest, read by an encoder at 100 Hz."""
    time = np.arange(0.0, seconds, 0.01)
    phase = 2.0 * np.pi * time / seconds
    swing = np.sin(0.5 * phase) ** 2
    rows = [0.8 * swing, -0.5 * swing * np.sin(2.0 * phase), 0.3 * swing * np.cos(3.0 * phase)]
    return HandPath(time + 77.0, np.round(np.array(rows).T / TICK) * TICK)


@given(paths(), st.sampled_from([1e-4, 0.01, 0.1]))
def test_no_sample_is_further_than_the_bound(path: HandPath, bound: float) -> None:
    points = simplify(path, bound)
    assert deviation(points, path).size <= bound + 1e-9
    assert (np.diff(points.time) > 0.0).all()


@given(paths())
def test_both_ends_are_kept_and_are_at_rest(path: HandPath) -> None:
    points = simplify(path, 0.01)
    assert points.velocity is not None
    assert (points.velocity[[0, -1]] == 0.0).all()
    begun = np.flatnonzero(points.time == 0.0)
    ended = np.flatnonzero(points.time == path.time[-1] - path.time[0])
    assert (points.position[begun[0]] == path.position[0]).all()
    assert (points.position[ended[0]] == path.position[-1]).all()
    assert points.time[0] in (0.0, -RAMP)


@given(paths(), st.floats(1.0, 5.0), st.integers(0, 80))
def test_a_slower_path_has_the_same_samples_later(path: HandPath, pace: float, place: int) -> None:
    paces = np.ones(len(path.time))
    paces[place % len(paces)] = pace
    slower = path.slowed(paces)
    assert (slower.position == path.position).all()
    assert slower.time[0] == path.time[0]
    ratio = np.diff(slower.time) / np.diff(path.time)
    assert (ratio >= 1.0 - 1e-9).all()
    assert (ratio <= pace + 1e-9).all()
    far = np.abs(path.time - path.time[place % len(paces)]) > BLEND
    assert ratio[far[1:] & far[:-1]] == pytest.approx(1.0)


def test_a_path_slowed_by_its_excess_comes_within_the_limits() -> None:
    path = guided()
    velocity = np.full(3, 0.5)
    acceleration = np.full(3, 2.0)
    assert excess(simplify(path, 0.01), path, velocity, acceleration).max() > 1.3
    for _ in range(12):
        pace = excess(simplify(path, 0.01), path, velocity, acceleration)
        path = path.slowed(np.where(pace > 1.0, 1.01 * pace, 1.0))
    assert excess(simplify(path, 0.01), path, velocity, acceleration).max() <= 1.0
    assert path.time[-1] - path.time[0] < 1.5 * 6.0  # slow places take longer, not all


def test_a_smooth_guidance_needs_few_points() -> None:
    path = guided()
    points = simplify(path, 0.01)
    assert len(points.time) <= 20 < len(path.time) // 10
    assert points.velocity is not None
    # the speed of a joint that swings 0.8 rad to and fro in 6 s, not that of its encoder's steps
    assert np.abs(points.velocity[:, 0]).max() <= 1.1 * 0.4 * 2.0 * np.pi / 6.0


def test_a_lower_bound_needs_more_points() -> None:
    counts = [len(simplify(guided(), bound).time) for bound in (0.05, 0.01, 0.002)]
    assert counts == sorted(set(counts))


def test_a_path_cut_in_motion_gets_ramps_to_rest() -> None:
    whole = guided()
    cut = HandPath(whole.time[150:350], whole.position[150:350])
    points = simplify(cut, 0.01)
    assert points.time[0] == -RAMP
    assert points.time[-1] == np.float64(cut.time[-1] - cut.time[0]) + RAMP
    assert points.velocity is not None
    speed = _speed(cut.position[:3], cut.time[:3])
    assert np.abs(points.velocity[1]).max() > REST
    assert np.abs(points.position[0] - points.position[1]).max() <= 0.5 * RAMP * (speed + 0.3)


def test_a_hand_that_rests_gives_two_points() -> None:
    still = HandPath(np.arange(0.0, 3.0, 0.01), np.full((300, 2), 0.4))
    assert len(simplify(still, 0.01).time) == 2


def test_clipping_keeps_the_time() -> None:
    path = guided()
    kept = path.clipped(np.full(3, -0.1), np.full(3, 0.5))
    assert (kept.time == path.time).all()
    assert kept.position.max() == 0.5
    assert kept.position.min() == -0.1


def _speed(position: Floats, time: Floats) -> float:
    return float(np.abs((position[-1] - position[0]) / (time[-1] - time[0])).max())
