"""`twindctl policy`: what it shows, and what it refuses before anything is asked to move."""

import argparse
import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest

from twind.exceptions import InvalidInput

pytest.importorskip("onnx", reason="make extras EXTRAS=learn")

from tests.support.policy_files import TWO, written
from twind.command_line.verb import UsageError
from twind.config.robot_file import load_robot
from twind.ctl.ctl_main import main
from twind.learn.cards.driven_policy import command_for
from twind.learn.live.daemon_robot import plant_from_answer, require_mode
from twind.learn.policy import policy_command
from twind.learn.policy.policy_file import load
from twind.learn.policy.policy_run_command import _figures
from twind.robot_client.daemon_robot_file import require_same

CARD = replace(TWO, command={"forward": (0.0, 0.4)}, evaluation={"return": 12.5}, trained_steps=61440)
ROBOT = load_robot("h24-standing")


def robot_reply(**changed: Any) -> dict[str, Any]:
    """The answer of `GetRobot`, as far as it is looked at."""
    robot = asdict(replace(ROBOT, joints=(), buses=(), transmissions=()))
    return {"robot": robot | {"path": str(ROBOT.path)} | changed, "mjcf": ""}


def test_a_policy_card_is_printed_as_text_and_as_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path, CARD)
    assert main(["policy", "show", str(path)]) == 0
    said = capsys.readouterr().out
    assert "forward 0..0.4" in said and "return 12.5" in said and "hip knee" in said
    assert main(["policy", "show", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["joints"] == ["hip", "knee"]


def test_control_characters_in_a_card_do_not_reach_the_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["policy", "show", str(written(tmp_path, CARD, notes={"a": "\x1b[2J\nb"}))]) == 0
    assert "\x1b" not in capsys.readouterr().out


def test_a_file_that_is_none_is_refused_with_its_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "x.onnx").write_bytes(b"no")
    assert main(["policy", "show", str(tmp_path / "x.onnx")]) == 1
    assert "x.onnx: " in capsys.readouterr().err


def test_without_onnxruntime_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(policy_command, "find_spec", lambda _name: None)
    assert main(["policy", "show", str(tmp_path / "x.onnx")]) == 2
    error = capsys.readouterr().err
    assert "policy needs onnxruntime: " in error and "policy" in error.partition("onnxruntime: ")[2]


def test_without_a_daemon_a_run_ends_with_3(tmp_path: Path) -> None:
    assert main(["--socket", str(tmp_path), "policy", "run", str(written(tmp_path, CARD))]) == 3


@pytest.mark.parametrize("text", ["1", "1,2", "a,b,c", "1,2,3,4", "nan,0,0", "0,inf,0"])
def test_a_command_is_three_finite_numbers(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match="numbers"):
        policy_command.command(text)


def test_a_command_outside_the_trained_range_is_refused(tmp_path: Path) -> None:
    policy = load(written(tmp_path, CARD))

    def asked(*numbers: float) -> list[float]:
        return command_for(argparse.Namespace(command=numbers or None), policy).tolist()

    assert asked() == [0.2, 0.0, 0.0] and asked(0.4, 0.0, 0.0) == [0.4, 0.0, 0.0]
    with pytest.raises(UsageError, match=r"forward 0\.5 is outside what it was trained for: 0\.\.0\.4"):
        asked(0.5, 0.0, 0.0)
    with pytest.raises(UsageError, match="turn"):
        asked(0.0, 0.0, 0.1)


def test_the_robot_must_be_the_one_that_the_daemon_runs() -> None:
    require_same(robot_reply(), ROBOT)
    with pytest.raises(InvalidInput, match="the daemon runs h24-standing"):
        require_same(robot_reply(text_sha256="0"), ROBOT)
    with pytest.raises(InvalidInput, match="has changed since the daemon read it"):
        require_same(robot_reply(mjcf="<mujoco/>"), ROBOT)
    with pytest.raises(InvalidInput, match="cannot be read here"):
        plant_from_answer(robot_reply(path="/nowhere/robot.yaml"), 0.02)


def test_the_robot_of_a_daemon_is_simulated_from_its_description() -> None:
    assert plant_from_answer(robot_reply(), 0.02).layout.joints == ROBOT.names


def ended(**changed: Any) -> dict[str, Any]:
    """Return the figures of a drive in which half of the periods were missed, with changes."""
    rest: dict[str, Any] = dict.fromkeys(("late_p50_ms", "late_p99_ms", "inference_p99_ms"))
    rest |= {"way_p50_ms": 4.0, "way_p99_ms": 6.0, "refused": 0, "refusals": {}, "why_held": []}
    robot_reply = {"steps": 250, "seconds": 10.0, "missed": 250, "too_late": 0, "holds": 2, "held_s": 1.26}
    return rest | robot_reply | {"most_tilt_deg": 1.0, "return_per_step": 1.5} | changed


def test_many_missed_periods_are_reported_with_hold_duration_and_remedy() -> None:
    said = "\n".join(_figures(ended()))
    assert "250 missed" in said and "2 holds of 1.3 s together" in said and "nice -n -10" in said
    few = "\n".join(_figures(ended(steps=499, missed=1, holds=0, held_s=0.0)))
    assert "busy" not in few and "0 holds, tilt" in few
    assert "busy" in "\n".join(_figures(ended(steps=499, missed=1, too_late=1)))


def test_a_mirror_shows_one_robot_and_moves_another() -> None:
    require_mode("sim")
    require_mode("live")
    with pytest.raises(InvalidInput, match="use sim or live"):
        require_mode("mirror")
