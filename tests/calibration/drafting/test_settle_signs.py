"""Signs by hand: counts that wrap, the wrong joint, a hand that moved too far; whose calibration is read."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.support.robot_description_files import ROBOTIS
from twind.command_line.verb import Rejected
from twind.config.robot_file import load_robot, read_robot
from twind.ctl.ctl_main import main
from twind.ctl.robot_file_edit import RobotFileEdit
from twind_calibration.drafting import finish_command
from twind_calibration.drafting.finish_command import FinishTask, with_calibration_of_daemon
from twind_calibration.robot_description import RobotDescription

TURN = 6.283185307179586


class Positions:
    """Stand-in for a connection: the positions that the daemon tells, one after each question."""

    def __init__(self, sha256: str, *places: float, torque: bool = False) -> None:
        self.sha256 = sha256
        self.places = places
        self.torque = torque
        self.asked = 0

    def call(self, method: str, **_: Any) -> dict[str, Any]:
        if method == "GetRobot":
            return {"robot": {"text_sha256": self.sha256}}
        status = {"mode": "mirror", "armed": self.torque}
        joint = {"name": "r_sho", "heard": True, "age_ms": 5.0, "torque": self.torque}
        return {"status": status, "joints": [joint | {"position": self.places[self.asked - 1]}]}

    def answer(self, question: str) -> str:
        """Answer a question: a hand has done what it asks for."""
        self.asked += "press Enter" in question
        return "fixed" if "carries" in question else ""


@pytest.mark.parametrize(
    ("places", "sign", "words"),
    [
        ((0.0, 0.5), 1, ""),
        ((0.0, -0.5), -1, ""),
        ((3.0, 3.5 - TURN), 1, ""),  # its count wraps on the way
        ((-3.0, -3.5 + TURN), -1, ""),
        ((0.0, 3.0, 0.0, 0.4), 1, "moved by more than 0.375 of a turn"),
        ((0.0, 0.01, 0.0, -0.4), -1, "nothing moved by 0.15 rad"),
    ],
)
def test_the_sign_is_that_of_the_shortest_movement(
    places: tuple[float, ...], sign: int, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "op.robot"
    source.write_text(ROBOTIS)
    assert main(["robot", "new", "op", "--folder", str(tmp_path / "op"), "--from", str(source)]) == 0
    file = tmp_path / "op" / "op.yaml"
    robot = read_robot(file)
    described = RobotDescription(robot, {}, None, tmp_path / "none.yaml", tmp_path)
    daemon = Positions(robot.text_sha256, *places)
    task = FinishTask(described, RobotFileEdit(file), daemon.answer)
    task.settle_signs(daemon, task.open_joints("sign"))  # type: ignore[arg-type]
    assert [joint.sign for joint in read_robot(file).joints] == [sign]
    assert words in capsys.readouterr().out


def test_signs_follow_answers_that_changed_the_file_in_the_same_run(tmp_path: Path) -> None:
    source = tmp_path / "op.robot"
    source.write_text(ROBOTIS)
    assert main(["robot", "new", "op", "--folder", str(tmp_path / "op"), "--from", str(source)]) == 0
    file = tmp_path / "op" / "op.yaml"
    robot = read_robot(file)
    daemon = Positions(robot.text_sha256, 0.0, 0.5)
    described = RobotDescription(robot, {}, None, tmp_path / "none.yaml", tmp_path)
    task = FinishTask(described, RobotFileEdit(file), daemon.answer)
    task.settle_answers(None, no_watchdog=False)
    joints = task.open_joints("sign")
    with pytest.raises(Rejected, match="restart it"):
        task.settle_signs(Positions("another file"), joints)  # type: ignore[arg-type]
    task.settle_signs(daemon, joints)  # type: ignore[arg-type]
    assert read_robot(file).todo == ("joints.r_sho.limits_rad", "poses.rest")


@pytest.mark.parametrize("rest", [False, True], ids=["sign", "rest pose"])
def test_a_robot_with_torque_settles_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, rest: bool
) -> None:
    """A robot that its torque holds up may fall without it, and no hand moves its joints."""
    source = tmp_path / "op.robot"
    source.write_text(ROBOTIS)
    assert main(["robot", "new", "op", "--folder", str(tmp_path / "op"), "--from", str(source)]) == 0
    file = tmp_path / "op" / "op.yaml"
    before = file.read_text()
    daemon = Positions(read_robot(file).text_sha256, 0.0, 0.5, torque=True)
    described = RobotDescription(read_robot(file), {}, None, tmp_path / "none.yaml", tmp_path)
    task = FinishTask(described, RobotFileEdit(file), daemon.answer)
    entries = SimpleNamespace(by_name=dict.fromkeys(joint.actuator for joint in task.robot.joints))
    monkeypatch.setattr(task, "_calibration", lambda: entries)
    monkeypatch.setattr(task, "_require_calibrated", lambda _: None)
    signs = partial(task.settle_signs, joints=task.open_joints("sign"))
    with pytest.raises(Rejected, match="torque is on: r_sho"):
        (task.settle_rest if rest else signs)(daemon)  # type: ignore[arg-type]
    assert file.read_text() == before


@pytest.mark.parametrize("named", ["desk/arm.yaml", None])
def test_the_calibration_is_the_one_that_the_daemon_of_this_robot_reads(
    named: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    described = _beside(tmp_path, monkeypatch, named and str(tmp_path / named))
    found = with_calibration_of_daemon(described, argparse.Namespace(calibration=None))
    assert found.calibration == tmp_path / (named or "state/calibration/h24.yaml")
    chosen = with_calibration_of_daemon(described, argparse.Namespace(calibration="mine.yaml"))
    assert chosen is described


def test_virtual_servos_do_not_tell_the_limits_of_the_robot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    described = _beside(tmp_path, monkeypatch, "/tmp/twind-virtual-x/calibration.yaml")
    with pytest.raises(Rejected, match="the daemon runs virtual servos"):
        with_calibration_of_daemon(described, argparse.Namespace(calibration=None))


def _beside(folder: Path, monkeypatch: pytest.MonkeyPatch, calibration: str | None) -> RobotDescription:
    """Return what the options describe, beside a daemon with that calibration file."""
    robot = load_robot("h24")

    class Daemon:
        def call(self, method: str) -> dict[str, Any]:
            parameters = {"calibration": calibration, "state_dir": str(folder / "state"), "individual": None}
            return {"GetRobot": {"robot": {"path": str(robot.path)}}}.get(method, {"parameters": parameters})

    @contextmanager
    def observer(_options: argparse.Namespace) -> Iterator[Daemon]:
        yield Daemon()

    monkeypatch.setattr(finish_command, "observer", observer)
    return RobotDescription(robot, {}, None, folder / "none.yaml", folder)
