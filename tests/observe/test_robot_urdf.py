"""URDF and frames of a robot: yourdfpy reads the URDF, and the kinematics are those of MuJoCo's model."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
import yourdfpy

from tests.support.robot_trees import built_in, odd_robot, placed
from twind.observe.describing import urdf_writer
from twind.observe.describing.robot_frames import robot_tree
from twind.observe.describing.urdf_writer import is_public, roll_pitch_yaw, urdf_text

EXACT = 1e-6  # m and direction cosines
ROBOTS = ("h24", "so101", "quadruped12")


def read(text: str, tmp_path: Path) -> yourdfpy.URDF:
    file = tmp_path / "robot.urdf"
    file.write_text(text)
    return yourdfpy.URDF.load(str(file), load_meshes=False, build_scene_graph=True)


@pytest.mark.parametrize("name", [*ROBOTS, "odd"])
def test_yourdfpy_places_every_link_where_mujoco_does(name: str, tmp_path: Path) -> None:
    tree, robot = odd_robot() if name == "odd" else built_in(name)
    urdf = read(urdf_text(tree, robot), tmp_path)
    draw = np.random.default_rng(25)
    for _ in range(20):
        angles = {each["name"]: draw.uniform(each["lower"], each["upper"]) for each in robot["joints"]}
        urdf.update_cfg(angles)
        data = placed(tree, robot, angles)
        base = data.body(robot["base"])
        turn = base.xmat.reshape(3, 3)
        for link, body in tree.links.items():
            if body:
                frame = urdf.get_transform(link, "base")
                place = turn.T @ (data.xpos[body] - base.xpos)
                np.testing.assert_allclose(frame[:3, 3], place, atol=EXACT, rtol=0.0)
                turned = turn.T @ data.xmat[body].reshape(3, 3)
                np.testing.assert_allclose(frame[:3, :3], turned, atol=EXACT, rtol=0.0)


def test_every_body_with_its_mass_and_every_joint_with_its_limits_is_in_the_urdf(tmp_path: Path) -> None:
    tree, robot = built_in("h24")
    urdf = read(urdf_text(tree, robot), tmp_path)
    assert list(urdf.actuated_joint_names) == [each["name"] for each in robot["joints"]]
    assert len(urdf.link_map) == 26  # 25 bodies, and the root
    for each in robot["joints"]:
        limit = urdf.joint_map[each["name"]].limit
        assert (limit.lower, limit.upper) == pytest.approx((each["lower"], each["upper"]))
        assert (limit.velocity, limit.effort) == pytest.approx((each["velocity_limit"], 4.1))
    masses = [link.inertial.mass for link in urdf.link_map.values() if link.inertial is not None]
    assert sum(masses) == pytest.approx(tree.model.body_mass.sum(), abs=1e-9)
    head = urdf.link_map["head"]
    assert head.collisions[0].geometry.sphere.radius == 0.045
    assert len(head.visuals) > len(head.collisions) == 1


def test_a_coupled_joint_follows_and_a_loose_one_and_the_scene_do_not_move(tmp_path: Path) -> None:
    tree, robot = odd_robot()
    urdf = read(urdf_text(tree, robot), tmp_path)
    assert "table" not in urdf.link_map
    assert urdf.base_link == "base"
    assert urdf.joint_map["loose_fixed"].type == "fixed"
    grip = urdf.joint_map["grip"]
    assert (grip.mimic.joint, grip.mimic.multiplier, grip.mimic.offset) == ("yaw", 0.05, 0.01)
    assert (grip.limit.lower, grip.limit.upper) == pytest.approx((-0.04, 0.11))
    assert urdf.joint_map["yaw"].limit.effort == 3.0


@pytest.mark.parametrize("public", [True, False])
def test_a_mesh_is_named_where_every_user_may_read_it_and_else_a_box(
    public: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh = tmp_path / "wedge.obj"
    mesh.write_text("v 0 0 0\nv 2 0 0\nv 0 1 0\nv 0 0 3\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    file = tmp_path / "robot.xml"
    file.write_text(
        '<mujoco><asset><mesh name="w" file="wedge.obj"/></asset><worldbody><body name="base">'
        '<geom type="mesh" mesh="w" pos="1 2 3"/></body></worldbody></mujoco>'
    )
    robot = {"name": "meshed", "base": "base", "mjcf_path": str(file), "joints": []}
    tree = robot_tree(mujoco.MjModel.from_xml_path(str(file)), robot)
    monkeypatch.setattr(urdf_writer, "is_public", lambda _: public)
    shape = read(urdf_text(tree, robot), tmp_path).link_map["base"].visuals[0]
    if public:
        assert shape.geometry.mesh.filename == mesh.as_uri()
        np.testing.assert_allclose(shape.origin[:3, 3], [1.0, 2.0, 3.0], atol=EXACT)
        np.testing.assert_allclose(shape.origin[:3, :3], np.eye(3), atol=EXACT)
    else:
        assert sorted(shape.geometry.box.size) == pytest.approx([1.0, 2.0, 3.0], rel=0.3)


def test_a_file_in_a_private_folder_is_not_public(tmp_path: Path) -> None:
    file = tmp_path / "mesh.stl"
    file.touch(0o644)
    tmp_path.chmod(0o700)
    assert not is_public(file)
    assert is_public(Path("/etc/passwd"))


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-7, 0.3])
def test_roll_pitch_and_yaw_give_the_rotation_back_also_where_the_axes_coincide(pitch: float) -> None:
    turn = np.zeros(4)
    mujoco.mju_euler2Quat(turn, np.array([0.4, pitch, -1.2]), "XYZ")
    again = np.zeros(4)
    mujoco.mju_euler2Quat(again, np.array(roll_pitch_yaw(turn)), "XYZ")
    assert abs(turn @ again) == pytest.approx(1.0, abs=EXACT**2)
