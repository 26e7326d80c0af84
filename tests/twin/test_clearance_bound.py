"""Poses that the bound proves to be clear are clear: an oracle measures every pair in each of them."""

from pathlib import Path

import numpy as np
import pytest

from tests.support.clearance_rig import Oracle, arm, h24
from twind.robot.arrays import Floats
from twind.twin.binding import Binding
from twind.twin.clearance_bound import REACH, ClearanceBound
from twind.twin.collision_model import CollisionModel


class Around:
    """A bound and an oracle of one robot; `watched`, m."""

    def __init__(self, binding: Binding, watched: float) -> None:
        self.binding = binding
        bodies = CollisionModel(binding, REACH)
        self.watched = np.full(len(bodies.pairs), watched)
        self.bound = ClearanceBound(bodies, self.watched)
        self.oracle = Oracle(binding, [pair.geoms for pair in bodies.pairs])

    def poses(self, random: np.random.Generator, pose: Floats, count: int, reach: float) -> Floats:
        limits = self.binding.limits
        step = random.uniform(-reach, reach, (count, len(pose))) * random.random((count, 1))
        return np.clip(pose + step, limits.lower, limits.upper)


@pytest.mark.parametrize(("robot", "reach"), [("arm", 0.3), ("h24", 0.06)])
@pytest.mark.parametrize("watched", [0.0, 0.01, 0.02])
def test_what_is_proven_clear_is_farther_than_watched(
    tmp_path: Path, robot: str, reach: float, watched: float
) -> None:
    around = Around(arm(tmp_path) if robot == "arm" else h24(), watched)
    random = np.random.default_rng(3)
    proven = 0
    for _ in range(12):
        pose = around.poses(random, np.array(around.binding.rest), 1, 10.0 * reach)[0]
        around.bound.measure(pose)
        poses = around.poses(random, pose, 20, reach)
        clear = around.bound.clear(poses)
        proven += int(clear.sum())
        for each in poses[clear]:
            assert (around.oracle.row(each) > around.watched).all()
    assert proven > 10


def test_nothing_is_proven_before_a_measurement_or_of_a_pose_that_is_none(tmp_path: Path) -> None:
    around = Around(arm(tmp_path), 0.01)
    rest = np.array(around.binding.rest)
    assert not around.bound.clear(rest[None]).any()
    around.bound.measure(rest)
    assert around.bound.clear(rest[None]).all()
    assert not around.bound.clear(np.array([[0.0, np.nan, 0.0]])).any()


def test_one_pose_that_is_not_clear_leaves_the_others_proven(tmp_path: Path) -> None:
    around = Around(arm(tmp_path), 0.01)
    rest = np.array(around.binding.rest)
    around.bound.measure(rest)
    poses = np.array([rest, rest + np.array([0.0, 2.0, 0.0]), rest])
    assert around.bound.clear(poses).tolist() == [True, False, True]


def test_a_measured_pose_may_change_afterwards(tmp_path: Path) -> None:
    around = Around(arm(tmp_path), 0.01)
    pose = np.array(around.binding.rest)
    around.bound.measure(pose)
    pose[1] = 2.9
    assert around.bound.clear(np.array(around.binding.rest)[None]).all()
