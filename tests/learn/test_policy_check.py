"""`policy check`: what it finds before a robot is touched, on a standing robot in simulation."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("onnx", reason="make extras EXTRAS=learn")

from tests.support.card_files import (
    FOREARM,
    INTO_PELVIS,
    STANDING,
    STANDING_LSTM,
    STANDING_PLAIN,
    carded,
    linear,
    lstm,
)
from tests.support.policy_files import plain
from tests.support.standing_policy import CARD, bending
from twind.ctl.ctl_main import main
from twind.learn.policy.policy_file import save

Lines = dict[str, tuple[str, str]]
ENTRIES = 7  # four joints and the gyro


def checked(path: Path, capsys: pytest.CaptureFixture[str], *options: str) -> tuple[int, Lines]:
    """Exit code, and verdict and text by name."""
    code = main(["policy", "check", str(path), "--seconds", "1.5", "--json", *options])
    lines = map(json.loads, capsys.readouterr().out.splitlines())
    return code, {each["name"]: (each["verdict"], each["text"]) for each in lines}


def test_a_policy_that_holds_the_pose_passes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, lines = checked(carded(tmp_path, linear(ENTRIES, 4), STANDING + STANDING_PLAIN), capsys)
    assert code == 0 and lines["limits"] == ("ok", "they admit the default pose and all of action.clip")
    assert lines["robot"][1] == "h24-standing: 24 joints; 50 actions per second, 2 ticks of the loop each"
    assert lines["vectors"][0] == "warn" and lines["inference"][0] != "fail"
    assert lines["drive"][0] == "ok" and lines["gate"] == ("ok", "refused setpoints: none")
    assert lines["limits in motion"][1].startswith("followed late: never; 0.00 targets")


def test_a_recurrent_policy_is_checked_alike(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, lines = checked(carded(tmp_path, lstm(ENTRIES, 4), STANDING + STANDING_LSTM), capsys)
    assert code == 0 and lines["drive"][0] == "ok", lines


def test_a_policy_that_falls_fails(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    network = linear(ENTRIES, 4, bias=[-0.9, 0.9, 0.9, -0.9])
    code, lines = checked(carded(tmp_path, network, STANDING + STANDING_PLAIN), capsys)
    assert code == 1 and lines["drive"][0] == "fail" and lines["drive"][1].endswith("; fallen")


def test_a_policy_that_the_limits_slow_is_reported_by_joint(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It shakes a knee: its action is the opposite of its last one."""
    text = STANDING_PLAIN.replace("joint_position: {}", "last_action: {}")
    weight = np.zeros((ENTRIES, 4), np.float32)
    weight[0, 0] = -3.0
    network = linear(ENTRIES, 4, weight=weight, bias=[1.0, 0.0, 0.0, 0.0])
    _, lines = checked(carded(tmp_path, network, STANDING + text), capsys)
    assert lines["limits in motion"][0] == "warn" and "_LIMIT l_knee in " in lines["limits in motion"][1]


def test_a_policy_on_its_way_into_a_collision_fails(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, lines = checked(carded(tmp_path, linear(2, 2, bias=INTO_PELVIS), FOREARM), capsys)
    assert code == 1 and "held by LOOKAHEAD_COLLISION" in lines["drive"][1]
    assert lines["collision"][0] == "warn" and "l_forearm-pelvis in " in lines["collision"][1]


def test_an_action_that_reaches_beyond_the_limits_is_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = STANDING_PLAIN.replace("[-1.0, 1.0]", "[-4.0, 4.0]")
    _, lines = checked(carded(tmp_path, linear(ENTRIES, 4), STANDING + text), capsys)
    assert lines["limits"][0] == "warn" and "l_knee by 1.30 rad" in lines["limits"][1]


def test_test_vectors_are_replayed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(0)
    weight = rng.normal(0.0, 0.1, (ENTRIES, 4)).astype(np.float32)
    seen = rng.normal(0.0, 1.0, (5, ENTRIES)).astype(np.float32)
    path = carded(
        tmp_path, linear(ENTRIES, 4, weight=weight), STANDING + STANDING_PLAIN + "test: {file: v.npz}\n"
    )
    expected = seen @ weight
    for actions, verdict in ((expected, "ok"), (expected + 0.01, "fail"), (expected[:3], "fail")):
        np.savez(tmp_path / "v.npz", obs=seen, actions=actions)
        code, lines = checked(path, capsys)
        assert lines["vectors"][0] == verdict and (code == 0) == (verdict == "ok"), lines["vectors"]


def test_test_vectors_of_a_recurrent_policy_go_on_from_step_to_step(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import onnxruntime

    path = carded(tmp_path, lstm(ENTRIES, 4), STANDING + STANDING_LSTM + "test: {file: v.npz}\n")
    session = onnxruntime.InferenceSession(str(path))
    seen = np.random.default_rng(0).normal(0.0, 1.0, (6, 1, ENTRIES)).astype(np.float32)
    h = c = np.zeros((1, 1, 16), np.float32)
    actions = []
    for row in seen:
        action, h, c = session.run(["actions", "h_out", "c_out"], {"obs": row, "h_in": h, "c_in": c})
        actions.append(action)
    np.savez(tmp_path / "v.npz", obs=seen, actions=actions)
    assert checked(path, capsys)[1]["vectors"][0] == "ok"


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("../v.npz", b"", "lie in the folder of the card"),
        ("v.npz", b"no zip", "cannot be read as an .npz file of numbers"),
        ("missing.npz", None, "cannot be read as an .npz file of numbers"),
    ],
)
def test_a_file_of_vectors_that_is_none_fails(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, content: Any, message: str
) -> None:
    card = STANDING + STANDING_PLAIN + f"test: {{file: {name}}}\n"
    path = carded(tmp_path, linear(ENTRIES, 4), card)
    if content is not None:
        (tmp_path / "v.npz").write_bytes(content)
    verdict, text = checked(path, capsys)[1]["vectors"]
    assert verdict == "fail" and message in text


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("rate_hz: 50.0", "rate_hz: 60.0", "rate_hz 60 does not divide the loop's 100: 100, 50, 33.3333, 25"),
        ("l_knee", "left_knee", "its card names left_knee, the robot has head_yaw"),
        ("l_knee: 0.6", "l_knee: 2.6", "default of l_knee is 2.6 rad, the robot allows -0.1..2.2"),
    ],
)
def test_a_robot_that_does_not_fit_ends_the_check(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, message: str
) -> None:
    path = carded(tmp_path, linear(ENTRIES, 4), (STANDING + STANDING_PLAIN).replace(old, new))
    code, lines = checked(path, capsys)
    assert code == 1 and list(lines) == ["robot"] and message in lines["robot"][1]


def test_a_policy_of_twindctl_train_is_checked_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save(tmp_path / "bends.onnx", bending(), *plain(CARD), CARD)
    code, lines = checked(tmp_path / "bends.onnx", capsys)
    assert lines["gate"][0] == "ok" and lines["limits in motion"][1].startswith("followed late: never"), lines
    assert code == 0


def test_a_command_outside_the_card_is_a_usage_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = carded(tmp_path, linear(ENTRIES, 4), STANDING + STANDING_PLAIN)
    assert main(["policy", "check", str(path), "--command", "0.5,0,0"]) == 2
    assert "forward 0.5 is outside what it was trained for: 0..0" in capsys.readouterr().err
