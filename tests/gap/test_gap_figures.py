from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.config.identified_spec import GapReference, IdentifiedJoint, IdentifiedModel
from twind.gap.gap_figures import JointGap, joint_gaps, total_gap
from twind.gap.gap_trend import IN_A_ROW, GapTrend
from twind.gap.motion_samples import MotionSamples

TIME = 0.01 * np.arange(1000)


def motion(delay: float = 0.05, amplitude: float = 0.4) -> MotionSamples:
    goal = amplitude * np.sin(2.0 * TIME)[:, None]
    position = amplitude * 0.99 * np.sin(2.0 * (TIME - delay))[:, None]
    speed = np.gradient(position[:, 0], 0.01)[:, None]
    return MotionSamples(("hip",), TIME, goal, position, speed, 2.0 * position)


def figure(measured: MotionSamples, simulated: MotionSamples) -> JointGap:
    return joint_gaps(measured, simulated)[0]


@given(st.floats(0.05, 2.0))
def test_the_same_motion_has_no_gap(amplitude: float) -> None:
    found = figure(motion(amplitude=amplitude), motion(amplitude=amplitude))
    for each in (found.position, found.velocity, found.effort):
        assert each is not None and each.rms == each.nrmse_spread == 0.0


@given(st.floats(0.001, 0.1))
def test_a_figure_grows_as_the_error_does(size: float) -> None:
    measured = motion()
    error = size * np.cos(3.0 * TIME)[:, None]
    once = figure(measured, replace(measured, position=measured.position + error)).position
    twice = figure(measured, replace(measured, position=measured.position + 2.0 * error)).position
    assert once is not None and twice is not None and once.nrmse_spread and once.unexplained
    assert twice.nrmse_spread == pytest.approx(2.0 * once.nrmse_spread)
    assert twice.unexplained == pytest.approx(2.0 * once.unexplained)


@given(st.integers(0, 20))
def test_the_goal_delayed_as_the_robot_is_leaves_all_that_it_misses_unexplained(lag: int) -> None:
    measured = motion(0.01 * lag)
    delayed = np.vstack([np.full((lag, 1), np.nan), measured.goal[: len(TIME) - lag]])
    found = figure(measured, replace(measured, position=delayed))
    assert found.delay == pytest.approx(0.01 * lag)
    assert found.position is not None and found.position.unexplained == pytest.approx(1.0)


def test_a_joint_that_hardly_moved_and_one_without_goals_have_no_figure() -> None:
    still = motion(amplitude=0.01)
    assert figure(still, still).position is None
    limp = replace(motion(), goal=np.full((1000, 1), np.nan))
    found = figure(limp, limp)
    assert found.samples == 0 and found.position is None
    assert total_gap([found]) is None


def test_a_grown_gap_is_reported_once_until_it_was_calm() -> None:
    reference = IdentifiedJoint(gap=GapReference(spread=0.01, unexplained=0.2))
    trend = GapTrend(IdentifiedModel("h24", "", "", "", 0.0, 0.0, {"hip": reference}))
    measured = motion()

    def gap(share: float) -> list[JointGap]:
        return [replace(found, position=replace(found.position, unexplained=share))]

    found = figure(measured, measured)
    assert found.position is not None
    reports = [trend.update(gap(0.31)) for _ in range(2 * IN_A_ROW)]
    assert [len(each) for each in reports] == [0] * (IN_A_ROW - 1) + [1] + [0] * IN_A_ROW
    assert not trend.update(gap(0.25)) and not trend.update(gap(0.31))
    assert not trend.update(gap(0.2))
    assert sum(len(trend.update(gap(0.31))) for _ in range(IN_A_ROW)) == 1
    assert not GapTrend(None).update(gap(9.0))


def test_a_load_that_shows_in_effort_alone_is_reported_once_with_the_effort() -> None:
    reference = IdentifiedJoint(gap=GapReference(spread=0.01, unexplained=0.2, effort=0.16, effort_nm=0.1))
    trend = GapTrend(IdentifiedModel("h24", "", "", "", 0.0, 0.0, {"hip": reference}))
    found = figure(motion(), motion())

    def reports(position: float, effort: float, rms: float = 0.2) -> list[tuple[str, float]]:
        assert found.position is not None and found.effort is not None
        gap = replace(
            found,
            position=replace(found.position, unexplained=position),
            effort=replace(found.effort, unexplained=effort, rms=rms),
        )
        return [(each.quantity, each.bound) for _ in range(2 * IN_A_ROW) for each in trend.update([gap])]

    assert reports(0.29, 0.23) == []
    assert reports(0.29, 0.6, rms=0.1) == []  # of a motion that needs little effort
    assert reports(0.29, 0.29) == [("effort", pytest.approx(0.24))]
    assert reports(0.35, 0.29) == []  # it is known already
    assert reports(0.35, 0.16) == [
        ("position", pytest.approx(0.3))
    ]  # the effort is calm, the position is not
    assert reports(0.35, 0.29) == []
    assert reports(0.29, 0.29) == []  # neither grown nor calm
    assert reports(0.2, 0.29) == [("effort", pytest.approx(0.24))]
    assert reports(0.2, 0.16) == []
    assert reports(0.35, 0.16) == [("position", pytest.approx(0.3))]
    assert not GapTrend(None).update([found])
