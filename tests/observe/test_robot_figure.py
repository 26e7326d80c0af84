"""Bodies that the viewer draws, and their places."""

import numpy as np
import pytest

from tests.support.viewer_messages import GROUP_THREE, h24, other, status
from twind.exceptions import InvalidInput
from twind.observe.viewing import status_html
from twind.observe.viewing.robot_figure import shown_geoms
from twind.observe.viewing.robot_model import RobotModel
from twind.observe.viewing.robot_scene import AUTO, BOTH, NONE, ghosts
from twind.observe.viewing.viewer_state import ViewerState


def test_every_joint_turns_its_own_body_of_the_model() -> None:
    robot = h24()
    likeness = RobotModel(robot)
    still = likeness.places(likeness.rest)
    for place, name in enumerate(likeness.joints):
        pose = likeness.rest.copy()
        pose[place] += 0.3
        moved = likeness.places(pose).differ(still, 1e-6, 1e-3)
        assert moved[likeness.bodies_of[place]], name
        assert not moved[likeness.model.body("torso").id]


def test_a_joint_that_is_not_known_is_drawn_at_rest() -> None:
    likeness = RobotModel(h24())
    unknown = likeness.places(np.full(len(likeness.rest), np.nan))
    assert not unknown.differ(likeness.places(likeness.rest), 1e-9, 1e-6).any()


def test_the_nearest_pair_is_given_with_its_bounds_and_end_points() -> None:
    likeness = RobotModel(h24())
    near, touching = likeness.nearest(likeness.rest)
    assert near is not None and near.level == "clear" and len(touching) == 0
    assert np.linalg.norm(near.ends[1] - near.ends[0]) == pytest.approx(near.distance, abs=1e-3)
    pose = likeness.rest.copy()
    pose[likeness.joints.index("l_shoulder_roll")] = -0.14  # into the hip
    close, _ = likeness.nearest(pose)
    assert close is not None and close.distance < near.distance
    assert (close.block, close.warn) == (0.002, 0.01)


def test_bodies_that_have_shapes_in_group_three_alone_are_drawn_with_them() -> None:
    model = RobotModel(other()).model
    assert shown_geoms(model, model.body("trunk").id) == [1]
    both = GROUP_THREE.replace(
        '<geom type="box"', '<geom type="sphere" size="0.1" mass="1" group="1"/><geom type="box"'
    )
    model = RobotModel(other(both)).model
    assert [int(model.geom_group[g]) for g in shown_geoms(model, model.body("trunk").id)] == [1]


def test_an_unreadable_mesh_gets_a_placeholder_and_is_reported() -> None:
    mesh = '<asset><mesh name="m" file="gone.stl"/></asset><worldbody>'
    mjcf = GROUP_THREE.replace("<worldbody>", mesh).replace(
        '<geom type="capsule" fromto="0 0.03 0 0 0.03 -0.25" size="0.03" group="3" mass="0.2"/>',
        '<geom type="mesh" mesh="m" mass="0.2"/>',
    )
    likeness = RobotModel(other(mjcf))
    assert likeness.meshes_missing
    known = ViewerState()
    known.take(status())
    assert "balls stand for them" in status_html.page(known.now(), likeness, None, 0)


def test_an_invalid_model_is_refused() -> None:
    with pytest.raises(InvalidInput, match="cannot be compiled"):
        RobotModel(other("<mujoco><nonsense/></mujoco>"))
    with pytest.raises(InvalidInput, match="nowhere"):
        RobotModel(other(joints=("nowhere",)))


@pytest.mark.parametrize(
    ("choice", "mode", "shown"),
    [
        (AUTO, "live", (True, False)),
        (AUTO, "sim", (True, False)),
        (AUTO, "mirror", (False, True)),
        (BOTH, "live", (True, True)),
        (NONE, "mirror", (False, False)),
        ("simulation", "live", (False, True)),
    ],
)
def test_the_translucent_figure_is_what_takes_commands(
    choice: str, mode: str, shown: tuple[bool, bool]
) -> None:
    assert ghosts(choice, mode) == shown
