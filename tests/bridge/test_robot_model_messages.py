"""/robot_description and transforms of the ROS bridge, against MuJoCo's own kinematics."""

import sys
from collections.abc import Mapping
from functools import reduce
from typing import Any

import msgspec
import mujoco
import numpy as np
import pytest
import yourdfpy

from tests.support.robot_trees import built_in, odd_robot, placed
from twind.bridge.ros.robot_model_messages import SHAPES, RobotModelMessages, describe
from twind.config.robot_file import load_robot
from twind.exceptions import OperationFailed
from twind.ros import STRING, TRANSFORMS, decode
from twind.twin.binding import bind

EXACT = 1e-6  # m and direction cosines
Frames = Mapping[str, tuple[str, np.ndarray]]  # child -> parent, 4 x 4


def frames(data: bytes) -> dict[str, tuple[str, np.ndarray]]:
    return {each["child_frame_id"]: frame(each) for each in decode(TRANSFORMS, data)["transforms"]}


def frame(row: Mapping[str, Any]) -> tuple[str, np.ndarray]:
    move, turn = row["transform"]["translation"], row["transform"]["rotation"]
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, np.array([turn[key] for key in "wxyz"]))
    pose = np.eye(4)
    pose[:3, :3] = matrix.reshape(3, 3)
    pose[:3, 3] = [move[key] for key in "xyz"]
    return row["header"]["frame_id"], pose


def chain(tree: Frames, link: str) -> np.ndarray:
    poses = []
    while link != "base":
        link, pose = tree[link]
        poses.append(pose)
    return reduce(np.matmul, reversed(poses), np.eye(4))


@pytest.mark.parametrize("name", ["h24", "so101", "odd"])
def test_transforms_place_every_link_where_mujoco_does(name: str) -> None:
    tree, robot = odd_robot() if name == "odd" else built_in(name)
    messages = RobotModelMessages("", tree.table())
    names = [each["name"] for each in robot["joints"]]
    still = frames(messages.fixed(1))
    draw = np.random.default_rng(24)
    for _ in range(20):
        angles = {each["name"]: draw.uniform(each["lower"], each["upper"]) for each in robot["joints"]}
        known = still | frames(messages.moving(names, list(angles.values()), 2))
        data = placed(tree, robot, angles)
        base = data.body(robot["base"])
        turn = base.xmat.reshape(3, 3)
        for link, body in tree.links.items():
            if body:
                pose = chain(known, link)
                place = turn.T @ (data.xpos[body] - base.xpos)
                np.testing.assert_allclose(pose[:3, 3], place, atol=EXACT, rtol=0.0)
                turned = turn.T @ data.xmat[body].reshape(3, 3)
                np.testing.assert_allclose(pose[:3, :3], turned, atol=EXACT, rtol=0.0)


def test_a_joint_without_a_position_has_no_transform_and_prepared_bytes_are_bounded() -> None:
    tree, robot = built_in("h24")
    messages = RobotModelMessages("", tree.table())
    names = [each["name"] for each in robot["joints"]]
    assert "neck" in frames(messages.moving(names, [0.0] * 24, 1))
    for count in range(SHAPES + 5):
        some = [name for place, name in enumerate(names[1:]) if count >> place % 6 & 1]
        assert "neck" not in frames(messages.moving(some, [0.0] * len(some), 1))
    assert len(messages.prepared) <= SHAPES


def test_the_process_describes_the_robot_of_a_daemon(tmp_path: Any) -> None:
    robot = load_robot("h24")
    answer = {"robot": msgspec.to_builtins(robot, enc_hook=str), "mjcf": bind(robot, None).mjcf}
    found = describe(sys.executable, answer)
    file = tmp_path / "h24.urdf"
    file.write_text(decode(STRING, found.urdf)["data"])
    assert len(yourdfpy.URDF.load(str(file), load_meshes=False).actuated_joint_names) == 24
    assert frames(found.fixed(1)).keys() == {"torso"}
    with pytest.raises(OperationFailed, match="cannot be compiled"):
        describe(sys.executable, answer | {"mjcf": "<mujoco><what/></mujoco>"})
    with pytest.raises(OperationFailed, match="URDF"):
        describe(str(tmp_path / "none"), answer)
