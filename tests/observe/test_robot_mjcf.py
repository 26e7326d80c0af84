"""`robot export --mjcf`: the written model moves as that of the robot file with its identified model."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import trimesh

from twind.config.identified_file import save_identified
from twind.config.identified_spec import (
    IdentifiedBody,
    IdentifiedJoint,
    IdentifiedModel,
    ParameterEstimate,
    PositionEstimate,
)
from twind.config.robot_file import load_robot
from twind.config.robot_spec import RobotFile
from twind.ctl.ctl_main import main
from twind.exceptions import InvalidInput
from twind.observe.describing import mjcf_writer
from twind.observe.describing.mjcf_writer import write_mjcf
from twind.twin.identified_model import apply_identified

ROBOT = load_robot("h24")


def number(value: float) -> ParameterEstimate:
    return ParameterEstimate(value, 0.0, 38.0, 0.0)


def identified(robot: RobotFile = ROBOT) -> RobotFile:
    """The robot with odd figures that no writer of six digits keeps."""
    joints = {
        "l_knee": IdentifiedJoint(
            stiffness_nm_per_rad=number(31.123456789),
            damping_nm_s_per_rad=number(0.7654321987),
            friction_nm=number(0.1357924681),
            armature_kg_m2=number(0.01234567891),
            delay_s=number(0.0123),
        ),
        "head_yaw": IdentifiedJoint(friction_nm=number(0.05)),
    }
    body = IdentifiedBody(
        number(1.234567891), PositionEstimate((0.01, -0.02, 0.0300001), (0.0,) * 3, (0.0,) * 3)
    )
    bodies = {"torso": body}
    model = IdentifiedModel(robot.name, "2026-11-28T10:00:00Z", "test", "test", 1.0, 0.25, joints, bodies)
    return replace(robot, identified=model)


def path_of(model: Any, steps: int = 600) -> np.ndarray:
    """Positions (steps, nq) while the goals swing."""
    data = mujoco.MjData(model)
    rows = []
    for step in range(steps):
        data.ctrl[:] = 0.3 * np.sin(0.02 * step + np.arange(model.nu))
        mujoco.mj_step(model, data)
        rows.append(data.qpos.copy())
    return np.array(rows)


def own(robot: RobotFile) -> Any:
    spec = mujoco.MjSpec.from_file(str(robot.mjcf_path))
    apply_identified(spec, robot)
    return spec.compile()


def test_the_written_model_moves_as_the_identified_one(tmp_path: Path) -> None:
    robot = identified()
    write_mjcf(robot, tmp_path / "out.xml")
    written = path_of(mujoco.MjModel.from_xml_path(str(tmp_path / "out.xml")))
    np.testing.assert_allclose(written, path_of(own(robot)), atol=1e-9)
    assert np.abs(written - path_of(own(ROBOT))).max() > 1e-3  # which the robot file's own does not


@pytest.mark.parametrize("name", ["h24", "so101", "quadruped12", "koch", "pan-tilt"])
def test_every_built_in_robot_can_be_written(name: str, tmp_path: Path) -> None:
    robot = load_robot(name)
    write_mjcf(robot, tmp_path / "out.xml")
    np.testing.assert_array_equal(
        path_of(mujoco.MjModel.from_xml_path(str(tmp_path / "out.xml")), 50), path_of(own(robot), 50)
    )


def with_meshes(folder: Path) -> RobotFile:
    """h24 in two files, with two meshes of the same file name."""
    for sub, radius in (("left", 0.02), ("right", 0.03)):
        (folder / "meshes" / sub).mkdir(parents=True)
        ball = trimesh.creation.icosphere(subdivisions=1, radius=radius).export(file_type="stl")
        (folder / "meshes" / sub / "ball.stl").write_bytes(ball)
    text = ROBOT.mjcf_path.read_text()
    head, _, rest = text.partition("  <actuator>")
    actuators, _, tail = rest.partition("</actuator>")
    (folder / "servos.xml").write_text(f"<mujoco><actuator>{actuators}</actuator></mujoco>")
    assets = '<asset><mesh name="l" file="left/ball.stl"/><mesh name="r" file="right/ball.stl"/></asset>'
    head = head.replace("<worldbody>", f"{assets}<worldbody>", 1)
    head = head.replace('angle="radian"', 'angle="radian" meshdir="meshes"', 1)
    shapes = '<geom type="mesh" mesh="l" mass="0"/><geom type="mesh" mesh="r" pos="0 0 0.1" mass="0.01"/>'
    head = head.replace("<freejoint", f"{shapes}<freejoint", 1)
    (folder / "robot.xml").write_text(f'{head}<include file="servos.xml"/>{tail}')
    return replace(ROBOT, mjcf_path=folder / "robot.xml")


def test_meshes_are_copied_and_included_files_are_joined(tmp_path: Path) -> None:
    (tmp_path / "source").mkdir()
    robot = with_meshes(tmp_path / "source")
    expected = path_of(own(robot), 100)
    out = tmp_path / "out"
    out.mkdir()
    write_mjcf(robot, out / "model.xml")
    (tmp_path / "source").rename(tmp_path / "gone")
    out.rename(tmp_path / "moved")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "moved" / "model.xml"))
    np.testing.assert_array_equal(path_of(model, 100), expected)
    names = {each.name for each in (tmp_path / "moved" / "model-assets").iterdir()}
    assert names == {"ball.stl", "1-ball.stl"} and model.nmesh == 2


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "out.xml").write_text("mine")
    with pytest.raises(InvalidInput, match=r"out\.xml exists: remove it"):
        write_mjcf(ROBOT, tmp_path / "out.xml")
    assert (tmp_path / "out.xml").read_text() == "mine"


@pytest.mark.parametrize("name", ["model.xml", "model-assets"])
def test_what_another_program_makes_meanwhile_stays_and_nothing_else_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    (tmp_path / "source").mkdir()
    robot = with_meshes(tmp_path / "source")
    out = tmp_path / "out"

    def meanwhile(*_given: object) -> None:
        if name == "model-assets":
            (out / name).mkdir()
        (out / name / "theirs" if name == "model-assets" else out / name).write_text("theirs")

    monkeypatch.setattr(mjcf_writer, "_set_identified", meanwhile)
    out.mkdir()
    with pytest.raises(FileExistsError):
        write_mjcf(robot, out / "model.xml")
    kept = [each for each in out.rglob("*") if each.is_file()]
    assert [each.read_text() for each in kept] == ["theirs"]
    assert [each.name for each in out.iterdir()] == [name]


def test_a_broken_model_is_refused_and_nothing_is_left(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = ROBOT.mjcf_path.with_name("pan-tilt.yaml")
    file = tmp_path / "robot.yaml"
    file.write_text(own.read_text())
    (tmp_path / "pan-tilt.xml").write_text(own.with_suffix(".xml").read_text())  # without what it includes
    out = tmp_path / "made" / "out.xml"
    assert main(["robot", "export", str(file), "--mjcf", str(out)]) == 2
    assert "opening file 'servos.xml'" in capsys.readouterr().err and not out.parent.exists()
    assert main(["policy", "card", "--template", "isaaclab", "--robot", str(file)]) == 1
    assert "opening file 'servos.xml'" in capsys.readouterr().err


def test_the_folder_of_the_file_is_made(tmp_path: Path) -> None:
    assert main(["robot", "export", "koch", "--mjcf", str(tmp_path / "made" / "out.xml")]) == 0
    mujoco.MjModel.from_xml_path(str(tmp_path / "made" / "out.xml"))


def test_the_command_takes_an_identified_model(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot = identified()
    assert robot.identified is not None
    file = save_identified(robot.identified, tmp_path / "h24.yaml")
    out = tmp_path / "out.xml"
    assert main(["robot", "export", "h24", "--mjcf", str(out), "--identified", str(file)]) == 0
    model = mujoco.MjModel.from_xml_path(str(out))
    assert model.joint("l_knee").armature[0] == pytest.approx(0.01234567891, rel=1e-3)
    assert main(["robot", "export", "h24", "--mjcf", str(out)]) == 2
    assert "exists: remove it" in capsys.readouterr().err
