"""Imports that succeed: the model equals what MuJoCo and yourdfpy make of the same file."""

import re
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yourdfpy

from tests.support.model_files import copied_models, random_angles, read_here, sphere_stl
from twind_calibration.model_import.import_model import import_model
from twind_calibration.model_import.imported_model import ImportedModel, JointMimic
from twind_calibration.model_import.mesh_library import MAX_VERTICES

FRAMES = 1e-9  # m and direction cosines: agreement of forward kinematics
# As the import asks MuJoCo to read a URDF; the rest of the file is unchanged.
AS_IMPORTED = '<mujoco><compiler fusestatic="false" discardvisual="false" balanceinertia="true"/></mujoco>'


@pytest.fixture
def models(tmp_path: Path) -> Path:
    return copied_models(tmp_path)


def placed(model: ImportedModel, angles: np.ndarray) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The written model in a pose, followers where their leaders put them."""
    compiled = mujoco.MjModel.from_xml_path(str(model.file))
    data = mujoco.MjData(compiled)
    free = iter(angles)
    by_name = {joint.name: float(next(free)) for joint in model.joints if joint.mimic is None}
    for joint in model.joints:
        if joint.mimic is not None:
            by_name[joint.name] = joint.mimic.multiplier * by_name[joint.mimic.joint] + joint.mimic.offset
    for name, angle in by_name.items():
        data.qpos[compiled.joint(name).qposadr[0]] = angle
    mujoco.mj_kinematics(compiled, data)
    return compiled, data


def test_a_urdf_has_the_mass_inertia_and_pose_that_mujoco_reads(models: Path, tmp_path: Path) -> None:
    path = models / "arm.urdf"
    text = re.sub(r'(<robot name="arm">)', rf"\1{AS_IMPORTED}", path.read_text())
    own = mujoco.MjModel.from_xml_string(text)
    imported = mujoco.MjModel.from_xml_path(str(read_here(path, tmp_path / "new").file))
    assert [imported.body(i).name for i in range(imported.nbody)] == [
        own.body(i).name for i in range(own.nbody)
    ]
    for field in (
        "body_mass",
        "body_inertia",
        "body_ipos",
        "body_pos",
        "jnt_axis",
        "jnt_range",
        "dof_damping",
    ):
        np.testing.assert_allclose(getattr(imported, field), getattr(own, field), rtol=1e-12, atol=1e-15)
    for field in ("body_quat", "body_iquat"):
        np.testing.assert_allclose(getattr(imported, field), getattr(own, field), atol=1e-12)


@pytest.mark.parametrize("name", ["arm.urdf", "bot_description/urdf/bot.urdf.xacro"])
def test_forward_kinematics_are_those_of_yourdfpy(models: Path, tmp_path: Path, name: str) -> None:
    path = models / name
    model = read_here(path, tmp_path / "new")
    source = path
    if path.suffix == ".xacro":
        import xacro

        source = tmp_path / "expanded.urdf"
        text = path.read_text().replace("$(find bot_description)", str(models / "bot_description"))
        path.write_text(text.replace("$(find bot_hardware)", str(models / "bot_hardware")))
        source.write_text(xacro.process_file(str(path)).toxml())
    robot = yourdfpy.URDF.load(str(source), load_meshes=False, build_scene_graph=True)
    for angles in random_angles(model, 20):
        compiled, data = placed(model, angles)
        robot.update_cfg(dict(zip(_free(model), angles, strict=True)))
        for body in range(1, compiled.nbody):
            frame = robot.get_transform(compiled.body(body).name)
            np.testing.assert_allclose(data.xpos[body], frame[:3, 3], atol=FRAMES, rtol=0.0)
            np.testing.assert_allclose(data.xmat[body].reshape(3, 3), frame[:3, :3], atol=FRAMES, rtol=0.0)


def _free(model: ImportedModel) -> list[str]:
    return [joint.name for joint in model.joints if joint.mimic is None]


def test_joints_have_the_limits_of_the_file_and_zero_is_no_limit(models: Path, tmp_path: Path) -> None:
    shoulder, elbow = read_here(models / "arm.urdf", tmp_path / "new").joints
    assert (shoulder.range, shoulder.velocity, shoulder.effort) == ((-1.5, 1.4), 5.2, 3.5)
    assert (elbow.range, elbow.velocity, elbow.effort) == ((-2.0, 0.1), None, None)
    assert elbow.mimic == JointMimic("shoulder", -0.5, 0.1)
    assert shoulder.place == f"{models / 'arm.urdf'}:20:3"


def test_each_leading_joint_has_one_position_servo_and_the_base_its_exclusions(
    models: Path, tmp_path: Path
) -> None:
    model = read_here(models / "arm.urdf", tmp_path / "new")
    compiled = mujoco.MjModel.from_xml_path(str(model.file))
    assert [compiled.actuator(i).name for i in range(compiled.nu)] == ["shoulder"]
    assert compiled.actuator_gainprm[0, 0] == -compiled.actuator_biasprm[0, 1] > 0.0
    assert compiled.nexclude == 1
    assert any("servos assumed for 1 joints (shoulder)" in remark.text for remark in model.remarks)
    assert any("no <collision>" in remark.text and ":9:" in remark.place for remark in model.remarks)


def test_a_resting_arm_stays_where_its_servos_hold_it(models: Path, tmp_path: Path) -> None:
    model = mujoco.MjModel.from_xml_path(str(read_here(models / "arm.urdf", tmp_path / "new").file))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=1000)
    assert abs(data.joint("shoulder").qpos[0]) < 0.05
    assert abs(data.joint("shoulder").qvel[0]) < 1e-3


@pytest.mark.parametrize(("floating", "expected"), [(None, False), (False, False), (True, True)])
def test_a_base_floats_only_if_asked(
    models: Path, tmp_path: Path, floating: bool | None, expected: bool
) -> None:
    model = read_here(models / "arm.urdf", tmp_path / "new", floating=floating)
    assert (model.floating, model.base) == (expected, "base_link")


@pytest.mark.parametrize(("floating", "expected"), [(None, True), (False, False), (True, True)])
def test_an_mjcf_keeps_its_masses_and_loses_what_is_only_seen(
    models: Path, tmp_path: Path, floating: bool | None, expected: bool
) -> None:
    own = mujoco.MjModel.from_xml_path(str(models / "finger.xml"))
    model = read_here(models / "finger.xml", tmp_path / "new", floating=floating)
    imported = mujoco.MjModel.from_xml_path(str(model.file))
    assert model.floating is expected
    for field in ("body_mass", "body_inertia", "body_ipos"):
        np.testing.assert_allclose(getattr(imported, field), getattr(own, field), rtol=1e-9, atol=1e-15)
    assert model.mass == pytest.approx(own.body_mass.sum())
    assert (imported.nmesh, imported.ngeom) == (1, own.ngeom - 1)
    assert [joint.name for joint in model.joints] == ["knuckle", "joint_1"]
    text = " ".join(remark.text for remark in model.remarks)
    assert "actuators of knuckle became position servos" in text
    assert "body 'proximal': meshes that collide with nothing were dropped" in text


def test_a_xacro_file_is_expanded_with_its_packages_arguments_and_hardware(
    models: Path, tmp_path: Path
) -> None:
    path = models / "bot_description" / "urdf" / "bot.urdf.xacro"
    model = read_here(path, tmp_path / "new", arguments={"prefix": "r_"})
    shoulder, wrist = model.joints
    assert (shoulder.name, wrist.name) == ("r_shoulder", "r_wrist")
    assert shoulder.range == pytest.approx((-np.pi / 2, np.pi / 3))
    assert wrist.range is None
    assert shoulder.place.startswith(f"{path}:12:")
    (system,) = model.hardware
    assert (system.port, system.baud) == ("/dev/ttyUSB0", 1_000_000)
    first, second = system.joints
    assert (first.joint, first.device, first.id, first.reduction) == ("r_shoulder", "dxl11", 11, None)
    assert first.commands == ("position", "Goal Position")
    assert first.parameters["Position P Gain"] == "800"
    assert (second.id, second.reduction) == (12, -2.0)


def test_a_hull_is_small_and_within_its_mesh(models: Path, tmp_path: Path) -> None:
    path = models / "bot_description" / "urdf" / "bot.urdf.xacro"
    model = read_here(path, tmp_path / "new")
    compiled = mujoco.MjModel.from_xml_path(str(model.file))
    assert compiled.nmesh == 1
    assert compiled.nmeshvert <= MAX_VERTICES
    radii = np.linalg.norm(compiled.mesh_vert, axis=1)
    assert 0.036 < radii.min() <= radii.max() < 0.0401
    assert any("out of its hull" in remark.text for remark in model.remarks)


def test_a_mesh_of_300_000_faces_is_imported_in_a_process_of_its_own(models: Path, tmp_path: Path) -> None:
    (models / "bot_description" / "meshes" / "ball.stl").write_bytes(sphere_stl(7))
    path = models / "bot_description" / "urdf" / "bot.urdf.xacro"
    model = import_model(path, tmp_path / "new")
    assert model == replace(read_here(path, tmp_path / "other"), file=tmp_path / "new" / "bot.xml")
