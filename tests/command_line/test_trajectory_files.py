"""Trajectory files are read strictly; ROS shapes become the socket's."""

from pathlib import Path

import pytest

from twind.command_line.trajectory_files import (
    load_motion,
    motion_names,
    new_motion,
    read_trajectory,
    write_trajectory,
)
from twind.command_line.verb import Rejected, UsageError
from twind.config.robot_file import load_robot


def written(folder: Path, text: str) -> str:
    path = folder / "path.json"
    path.write_text(text)
    return str(path)


def test_built_in_motions_are_found_by_name() -> None:
    assert "wave" in motion_names()
    for name in motion_names():
        assert load_motion(name)["points"]


def test_motions_beside_a_robot_file_come_first(tmp_path: Path) -> None:
    (tmp_path / "wave.json").write_text('{"joint_names": ["x"], "points": []}')
    assert load_motion("wave", tmp_path)["joint_names"] == ["x"]
    assert motion_names(tmp_path) == ("wave",)
    assert load_motion("squat", tmp_path)["points"]


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("1.5", 1.5), ("2", 2), ('{"sec": 1, "nanosec": 250000000}', 1.25), ('{"nanosec": 5}', 5e-9), ("{}", 0)],
)
def test_time_may_be_seconds_or_sec_and_nanosec(tmp_path: Path, text: str, seconds: float) -> None:
    point = f'{{"positions": [0], "accelerations": [], "time_from_start": {text}}}'
    motion = load_motion(written(tmp_path, f'{{"header": 1, "joint_names": ["a"], "points": [{point}]}}'))
    assert motion == {"joint_names": ["a"], "points": [{"positions": [0], "time_from_start": seconds}]}


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ('{"points": [\n  {"positions": [1,]}]}', ":2:20: Expecting value"),
        ('{"points": [], "points": []}', "stands twice"),
        ('{"points": [NaN]}', "NaN"),
        ("[]", "expected an object with joint_names and points"),
        ('{"points": [1]}', r"points\[0\]: expected an object"),
        ('{"points": [{"positions": []}]}', r"points\[0\]"),
        ('{"points": [{"time_from_start": {"sec": 1.5}}]}', "whole sec and nanosec"),
        ('{"points": [{"time_from_start": {"secs": 1}}]}', "whole sec and nanosec"),
        (" " * (5 << 20), "larger than 4 MiB"),
    ],
)
def test_an_invalid_trajectory_file_is_rejected_with_its_position(
    tmp_path: Path, text: str, reason: str
) -> None:
    with pytest.raises(Rejected, match=reason):
        load_motion(written(tmp_path, text))


def test_an_unknown_name_lists_the_known_ones() -> None:
    with pytest.raises(UsageError, match=r"nearest: wave; known: .*wave"):
        load_motion("wvae")


HEAD = ("head_yaw", "head_pitch")
ARMS = ("l_shoulder_pitch", "l_shoulder_roll", "l_elbow", "waist_yaw")  # with the head: the joints of `reach`


@pytest.mark.parametrize(
    ("own", "joints", "known"),
    [
        (["greet"], HEAD, "known: greet; or give"),
        (["greet"], HEAD + ARMS, "known: greet, reach; or give"),
        ([], HEAD, "the robot has none; give the path of a file"),
    ],
)
def test_an_unknown_name_lists_motions_of_the_robot_only(
    tmp_path: Path, own: list[str], joints: tuple[str, ...], known: str
) -> None:
    for name in own:
        (tmp_path / f"{name}.json").write_text('{"joint_names": [], "points": []}')
    with pytest.raises(UsageError) as raised:
        load_motion("nothing", tmp_path, joints)
    assert f"no motion 'nothing' in {tmp_path} of the robot, nor a built-in one" in str(raised.value)
    assert f"; {known}" in str(raised.value)


# ------------------------------------------------------------------------------------------ written


MOTION = {"joint_names": ["a"], "points": [{"positions": [0.5], "velocities": [0.0], "time_from_start": 1.0}]}


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    path = new_motion("swing", tmp_path / "motions")
    write_trajectory(path, MOTION, replace=False)
    assert load_motion("swing", tmp_path / "motions") == MOTION
    assert [each.name for each in path.parent.iterdir()] == ["swing.json"]


def test_a_motion_that_is_there_is_replaced_only_on_request(tmp_path: Path) -> None:
    path = tmp_path / "swing.json"
    path.write_text("mine")
    with pytest.raises(FileExistsError):
        write_trajectory(path, MOTION, replace=False)
    assert path.read_text() == "mine"
    write_trajectory(path, MOTION, replace=True)
    assert read_trajectory(path) == MOTION
    assert [each.name for each in tmp_path.iterdir()] == ["swing.json"]


@pytest.mark.parametrize("name", ["", "a b", ".hidden", "x" * 65])
def test_a_name_of_no_motion_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(UsageError, match="no name of a motion"):
        new_motion(name, tmp_path)


def test_a_built_in_robot_takes_no_motions() -> None:
    with pytest.raises(UsageError, match=r"\./swing\.json"):
        new_motion("swing", load_robot("h24").motions)
    assert new_motion("./swing.json", None) == Path("swing.json")
