"""Before a path is sent: clearance, torque and balance of the curve that would be followed."""

from collections.abc import Generator
from pathlib import Path

import numpy as np
import pytest

from tests.support.clearance_rig import arm, arm_file, finished, still
from twind.exceptions import InvalidInput
from twind.robot.arrays import Floats
from twind.robot.finding import Finding, ReasonCode, Verdict
from twind.robot.splines import interpolate
from twind.robot.trajectory import Reference, Trajectory
from twind.twin.binding import bind
from twind.twin.trajectory_precheck import TrajectoryPrecheck, samples

ALL = np.ones(3, np.bool_)
FOLDED = [0.0, 2.85, 0.0]  # the tip inside the base


def judged(foresight: TrajectoryPrecheck, path: Trajectory, reference: Reference, **asked: bool) -> Verdict:
    verdict = finished(foresight.judging(path, reference, **asked))
    assert isinstance(verdict, Verdict)
    return verdict


@pytest.fixture
def foresight(tmp_path: Path) -> TrajectoryPrecheck:
    return TrajectoryPrecheck(arm(tmp_path), 0.01)


def test_a_path_into_itself_is_refused_with_time_point_and_bodies(foresight: TrajectoryPrecheck) -> None:
    path = Trajectory(np.array([1.0, 2.0, 3.0]), np.array([[0.0, 0.2, 0.0], [0.0, 1.0, 0.0], FOLDED]), ALL)
    verdict = judged(foresight, path, still(np.zeros(3)))
    first = verdict.refusals[0]
    assert first.code is ReasonCode.SELF_COLLISION
    assert first.point == 1
    assert 2.0 < (first.time or 0.0) < 3.0
    assert first.value is not None
    assert first.value < 0.0
    assert first.bound == 0.002
    assert {word for word in first.message.split() if word in ("base", "middle", "tip")} == {"base", "middle"}


def test_a_clear_path_is_accepted(foresight: TrajectoryPrecheck) -> None:
    path = Trajectory(np.array([1.0]), np.array([[0.5, 0.5, 0.5]]), ALL)
    assert judged(foresight, path, still(np.zeros(3))) == Verdict()


def test_joints_that_are_not_named_stay_where_they_are(tmp_path: Path) -> None:
    """The same command is clear or not by how the rest of the robot stands."""
    floor = '<geom name="floor" type="plane" size="2 2 0.1"/>'
    foresight = TrajectoryPrecheck(arm(tmp_path, support="fixed", world=floor), 0.01)
    only = np.array([False, True, False])
    path = Trajectory(np.array([1.0]), np.array([[np.nan, 0.6, np.nan]]), only)
    assert judged(foresight, path, still([0.0, 0.0, 0.0])).accepted
    refused = judged(foresight, path, still([0.5, 0.0, 0.0])).refusals
    assert {finding.code for finding in refused} == {ReasonCode.FLOOR}


def test_a_stop_that_was_asked_for_is_part_of_the_way(tmp_path: Path) -> None:
    """The last point is clear, the ramp to rest after it is not."""
    foresight = TrajectoryPrecheck(arm(tmp_path, "{allow: [[base, middle]]}"), 0.01)
    speed = np.array([[0.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
    path = Trajectory(np.array([0.5, 2.0]), np.array([[0.0, 0.1, 0.0], [0.0, 2.6, 0.0]]), ALL, speed)
    assert judged(foresight, path, still(np.zeros(3))).accepted
    refused = judged(foresight, path, still(np.zeros(3)), append_stop=True).refusals
    assert refused
    assert refused[0].point == 1


def test_the_way_to_a_first_point_at_once_is_judged_too(tmp_path: Path) -> None:
    """A path that begins at t = 0 somewhere else is led in; times stay those of the path."""
    foresight = TrajectoryPrecheck(arm(tmp_path), 0.01)
    path = Trajectory(np.array([0.0, 1.0]), np.array([FOLDED, FOLDED]), ALL)
    refused = judged(foresight, path, still(np.zeros(3))).refusals
    assert refused
    assert (refused[0].time, refused[0].point) == (0.0, 0)


def test_an_unknown_start_position_is_refused(foresight: TrajectoryPrecheck) -> None:
    path = Trajectory(np.array([1.0]), np.array([[0.5, 0.5, 0.5]]), ALL)
    refused = judged(foresight, path, still([0.0, np.nan, 0.0])).refusals
    assert [finding.joint for finding in refused] == [1]


def test_a_model_in_which_nothing_can_collide_gives_no_foresight(tmp_path: Path) -> None:
    robot = arm_file(tmp_path)
    xml = (tmp_path / "arm.xml").read_text()
    (tmp_path / "arm.xml").write_text(xml.replace("<geom ", '<geom contype="0" conaffinity="0" '))
    with pytest.raises(InvalidInput, match="no two bodies"):
        TrajectoryPrecheck(bind(robot, None), 0.01)


class Weak:
    """Says that joint 2 is too weak at half of the way, and remembers what it was shown."""

    def judging(
        self, time: Floats, position: Floats, velocity: Floats, acceleration: Floats
    ) -> Generator[None, None, Verdict]:
        self.shown = time, position, velocity, acceleration
        yield
        middle = float(time[len(time) // 2])
        return Verdict(
            (), (Finding(ReasonCode.TORQUE_INFEASIBLE, joint=2, time=middle, value=5.0, bound=4.0),)
        )


def test_torque_is_judged_on_the_same_curve(tmp_path: Path) -> None:
    weak = Weak()
    foresight = TrajectoryPrecheck(arm(tmp_path), 0.01, weak)
    path = Trajectory(np.array([0.5, 2.0]), np.array([[0.1, 0.1, 0.1], [0.5, 0.5, 0.5]]), ALL)
    verdict = judged(foresight, path, still(np.zeros(3)))
    assert [(w.code, w.joint, w.point) for w in verdict.warnings] == [(ReasonCode.TORQUE_INFEASIBLE, 2, 0)]
    time, position, *_ = weak.shown
    assert (time[0], time[-1]) == (0.0, 2.0)
    assert np.diff(time).max() <= 0.02 + 1e-9
    assert position[-1] == pytest.approx([0.5, 0.5, 0.5])


@pytest.mark.parametrize("degree", [1, 3, 5])
def test_samples_are_what_the_executor_follows(degree: int) -> None:
    rows = np.random.default_rng(degree).normal(size=(3, 3, 2))
    given = [rows[k] if degree > 2 * k else None for k in (0, 1, 2)]
    path = Trajectory(np.array([0.3, 0.7, 1.1]), rows[0], np.ones(2, np.bool_), given[1], given[2])
    curve = interpolate(path, still(np.zeros(2)))
    for time, position, velocity, acceleration in zip(*samples(curve), strict=True):
        reference = curve.sample(float(time))
        assert reference is not None
        assert position == pytest.approx(reference.position)
        assert velocity == pytest.approx(reference.velocity)
        assert acceleration == pytest.approx(reference.acceleration)


def test_samples_are_bounded() -> None:
    path = Trajectory(np.array([60.0, 3600.0]), np.array([[1.0], [2.0]]), np.ones(1, np.bool_))
    time, *rows = samples(interpolate(path, still(np.zeros(1))))
    assert len(time) == 3001
    assert all(len(row) == 3001 for row in rows)
