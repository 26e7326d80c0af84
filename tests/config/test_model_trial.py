"""A model that costs memory or time without bound is refused by file and bound, by every command."""

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import mujoco
import numpy as np
import pytest

from twind import cli
from twind.bounded_process import ProcessBounds
from twind.config import model_trial
from twind.config.model_numbers import MAX_DEPTH, MAX_FILES, require_sane_numbers
from twind.config.model_trial import require_readable_model
from twind.config.robot_file import built_in_robots, load_robot, read_robot
from twind.config.yaml_tree import ConfigError
from twind.ctl.ctl_main import main as ctl
from twind.exceptions import InvalidInput
from twind.twin.binding import bind
from twind.twin.model_bounds import BOUNDS
from twind.virtual.virtual_main import main as virtual

SMALL = load_robot("pan-tilt")
WORLD = "<worldbody>"
MASS = 'size="0.014 0.048 0.02" mass="0.09"'
COPIES = (
    '<replicate count="10000"><replicate count="10000"><body><geom size="1"/></body></replicate></replicate>'
)


def robot_with(folder: Path, found: str, made: str) -> Path:
    """The small robot with a changed model; the path of its file."""
    assert found in SMALL.mjcf
    (folder / "pan-tilt.xml").write_text(SMALL.mjcf.replace(found, made, 1))
    (folder / "servos.xml").write_text((SMALL.mjcf_path.parent / "servos.xml").read_text())
    (folder / "odd.yaml").write_text(SMALL.path.read_text())
    return folder / "odd.yaml"


def before_world(text: str) -> str:
    return WORLD + text if text.startswith(("<replicate", "<body", "<geom")) else text + WORLD


def refused(path: Path) -> str:
    with pytest.raises(ConfigError) as caught:
        read_robot(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (
            '<asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/></asset>',
            "hfield nrow: .* 0 to 4096",
        ),
        ('<replicate count="100000000"><body/></replicate>', "replicate count: .* 1 to 10000"),
        (
            '<asset><texture name="t" type="2d" builtin="flat" width="100000" height="9"/></asset>',
            "texture width",
        ),
        ("<body>" * 300 + "</body>" * 300, f"body: larger than a robot: at most .* {MAX_DEPTH} levels"),
        ('<geom size="1" pos="0 nan 0"/>', "geom pos: .* is no finite number"),
        ('<geom size="1" pos="0 1e999 0"/>', "geom pos: .* is no finite number"),
    ],
)
def test_a_number_that_multiplies_or_is_not_finite_is_refused_at_its_place(
    tmp_path: Path, text: str, reason: str
) -> None:
    assert re.search(
        rf"pan-tilt\.xml:\d+:\d+: {reason}", refused(robot_with(tmp_path, WORLD, before_world(text)))
    )


@pytest.mark.parametrize("kind", ["pipe", "folder", "device", "socket", "large"])
@pytest.mark.parametrize("element", ["mesh", "hfield", "texture"])
def test_a_file_of_a_model_that_is_no_file_or_too_large_is_refused_unopened(
    tmp_path: Path, kind: str, element: str
) -> None:
    name = "/dev/zero" if kind == "device" else "odd.bin"
    path = tmp_path / "odd.bin"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "socket":
        subprocess.run(
            [sys.executable, "-c", "import socket; socket.socket(socket.AF_UNIX).bind('odd.bin')"],
            cwd=tmp_path,
            check=True,
        )
    else:
        path.touch()
        os.truncate(path, model_trial.MAX_FILE + 1)
    error = refused(
        robot_with(tmp_path, WORLD, before_world(f'<asset><{element} name="q" file="{name}"/></asset>'))
    )
    assert (
        "is larger than 64 MiB: decimate it" if kind == "large" else "is no file: name a regular one"
    ) in error


def test_more_files_than_a_model_has_are_refused(tmp_path: Path) -> None:
    for number in range(MAX_FILES + 1):
        (tmp_path / f"{number}.xml").write_text(f'<mujoco><include file="{number + 1}.xml"/></mujoco>')
    (tmp_path / f"{MAX_FILES + 1}.xml").write_text("<mujoco/>")
    with pytest.raises(ConfigError, match=f"more than {MAX_FILES} files: join them"):
        require_sane_numbers(tmp_path / "0.xml")


def test_what_no_number_in_the_text_tells_ends_at_the_bounds_of_a_process_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(model_trial, "BOUNDS", ProcessBounds(seconds=2, memory=768, output=1))
    error = refused(robot_with(tmp_path, WORLD, before_world(COPIES)))
    assert "pan-tilt.xml: " in error and "make it smaller" in error


@pytest.mark.parametrize("robot", built_in_robots())
def test_a_model_of_primitive_shapes_needs_no_process(robot: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(model_trial, "call_module", None)
    path = load_robot(robot).mjcf_path
    require_readable_model(path, require_sane_numbers(path))


@pytest.mark.parametrize(
    "text",
    [
        '<custom><numeric name="n" size="900000" data="1"/></custom>',
        "<asset>" + '<texture type="2d" builtin="flat" width="8192" height="8192"/>' * 25 + "</asset>",
        '<sensor><user dim="400000000"/></sensor>',
        '<sensor><gyro site="imu" nsample="200000000" delay="1"/></sensor>',
        '<actuator><motor joint="pan" delay="1" nsample="200000000"/></actuator>',
        '<actuator><general joint="pan" dyntype="user" actdim="400000000"/></actuator>',
        '<worldbody><camera name="c" resolution="20000 20000"/></worldbody>',
        '<size nkey="10000" nuserdata="1000000"/>',
        '<worldbody><body user="1 2 3"/></worldbody>',
        "<worldbody>" + '<site pos="0 0 0"/>' * 1000 + "</worldbody>",
    ],
)
def test_a_model_that_may_reserve_memory_is_tried_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str
) -> None:
    tried: list[str] = []
    monkeypatch.setattr(model_trial, "call_module", lambda worker, *others, **named: tried.append(worker))
    path = tmp_path / "model.xml"
    path.write_text(f"<mujoco>{text}<worldbody><body/></worldbody></mujoco>")
    require_readable_model(path, require_sane_numbers(path))
    assert tried == [model_trial.WORKER]


def test_a_model_with_a_mesh_passes_its_trial(tmp_path: Path) -> None:
    (tmp_path / "cube.obj").write_text(
        "".join(f"v {x} {y} {z}\n" for x in (0, 0.1) for y in (0, 0.1) for z in (0, 0.1))
        + "f 1 2 3\nf 5 6 7\n"
    )
    mesh = '<asset><mesh name="q" file="cube.obj"/></asset>'
    path = robot_with(tmp_path, WORLD, before_world(mesh))
    begun = time.monotonic()
    assert bind(read_robot(path), None).model.nmesh == 1
    assert time.monotonic() - begun < model_trial.BOUNDS.seconds


@pytest.mark.parametrize(
    ("found", "made", "reason"),
    [
        (
            MASS,
            'size="0.014 0.048 0.02" mass="1e300"',
            r"body 'camera': mass 1e\+300 is out of bounds: .* 0 to 10000 kg",
        ),
        (MASS, 'size="0.014 0.048 0.02" density="1e30"', "body 'camera': mass"),
        ('range="-0.9 0.9"', 'range="-1e9 1e9"', r"joint 'tilt': range -1e\+09 is out of bounds"),
        ('range="-0.9 0.9"', 'range="-0.9 0.9" damping="1e200"', r"joint 'tilt': damping 1e\+200"),
        ('range="-0.9 0.9"', 'range="-0.9 0.9" armature="1e200"', r"joint 'tilt': armature 1e\+200"),
        ('name="tilt" joint="tilt"', 'name="tilt" joint="tilt" kp="1e200"', r"actuator 'tilt': gain 1e\+200"),
    ],
)
def test_a_number_of_the_compiled_model_that_no_robot_has_is_refused(
    tmp_path: Path, found: str, made: str, reason: str
) -> None:
    robot = read_robot(robot_with(tmp_path, found, made))
    with pytest.raises(InvalidInput, match=reason):
        bind(robot, None)


def test_every_number_of_the_built_in_models_lies_within_a_tenth_of_the_bounds() -> None:
    for name in built_in_robots():
        model = mujoco.MjModel.from_xml_path(str(load_robot(name).mjcf_path))
        for array, bound in BOUNDS.items():
            assert np.abs(getattr(model, array)).max(initial=0.0) <= bound.most / 10, (name, array)


@pytest.mark.parametrize("command", ["check", "daemon", "virtual"])
def test_every_command_that_reads_a_robot_refuses_such_a_model(
    tmp_path: Path, command: str, capfd: pytest.CaptureFixture[str]
) -> None:
    os.mkfifo(tmp_path / "q.stl")
    path = str(robot_with(tmp_path, WORLD, before_world('<asset><mesh name="q" file="q.stl"/></asset>')))
    code = {
        "check": lambda: ctl(["check", "robot", path]),
        "daemon": lambda: cli.main(["--mode", "sim", "--robot", path]),
        "virtual": lambda: virtual(["--robot", path]),
    }[command]()
    assert code != 0
    assert "q.stl is no file: name a regular one" in capfd.readouterr().err
