"""`twindctl calibrate endstop`: what it asks, says and writes, of a daemon that tells it captures."""

import argparse
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from twind.command_line.verb import DONE, Rejected, UsageError
from twind.config.calibration_file import load_calibration, save_calibration
from twind.config.counts import ticks_of
from twind.config.robot_file import load_robot, read_robot
from twind.virtual.virtual_robot_spec import calibration, make_spec
from twind_calibration.calibrating.calibration_actuators import slots
from twind_calibration.calibrating.calibration_steps import STEPS
from twind_calibration.calibrating.endstop_command import EndstopPlan, _endstop, make_endstop_entry
from twind_calibration.calibrating.turn_command import _turn

ROBOT = load_robot("h24")
MADE = make_spec(ROBOT)
FITTING = calibration(MADE)
OTHERS = {
    "stop_rad: {lower: -2.8, upper: 2.8}": "stop_rad: {upper: 2.8}, homing: {side: upper, current_a: 0.2}"
}


class Daemon:
    """Answers what the verb asks, and remembers how it was asked."""

    connected = True

    def __init__(self, robot: Any, file: Path, counts: list[int] | None, mode: str = "live") -> None:
        self.robot = robot
        self.file = file
        self.counts = counts
        self.mode = mode
        self.asked: list[tuple[str, dict[str, Any]]] = []
        self.device: dict[str, Any] = {}

    def call(self, method: str, **how: Any) -> Any:
        self.asked.append((method, how))
        joints = [{"name": name, "position": 0.0, "torque": False} for name in self.robot.names]
        return {
            "GetRobot": {"robot": {"path": str(self.robot.path), "text_sha256": self.robot.text_sha256}},
            "GetParameters": {"parameters": {"calibration": str(self.file)}},
            "GetStatus": {"status": {"mode": self.mode}, "joints": joints},
        }.get(method, {})

    def stream(self, method: str, **how: Any) -> Iterator[Any]:
        self.asked.append((method, how))
        if method == "Scan":
            for entry in load_calibration(self.file, self.robot).joints:
                device = entry.device
                told = {
                    "homing_offset": device.homing_offset_ticks,
                    "drive_mode": device.drive_mode,
                    "operating_mode": device.operating_mode,
                    "min_position_limit": device.min_ticks,
                    "max_position_limit": device.max_ticks,
                }
                told |= self.device if entry.name == "head_yaw" else {}
                yield {
                    "id": entry.id,
                    "model": device.model_number,
                    "firmware": device.firmware,
                    "settings": told,
                }
            return
        yield {"phase": "waiting", "progress": 0.0}
        yield {"phase": "approaching", "progress": 0.2}
        if self.counts is None:
            finding = {"code": "STOP_NOT_FOUND", "message": "head_yaw: no stop"}
            yield {"phase": "failed", "progress": 1.0, "findings": [finding]}
        else:
            yield {"phase": "found", "progress": 1.0, "ticks": self.counts}

    @property
    def driven(self) -> dict[str, Any] | None:
        return next((how for method, how in self.asked if method == "FindStop"), None)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return save_calibration(FITTING, tmp_path, "one")


def options(*words: str, step: str = "endstop") -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--socket", default=None)
    parser.add_argument("--instance", default=None)
    STEPS[step].add_arguments(parser)
    return parser.parse_args(words)


def stop_of(name: str, side: str, off: int = 0) -> int:
    joint = next(joint for joint in ROBOT.joints if joint.name == name)
    angle = joint.stops.endstop_of_side(side)
    assert angle is not None
    return ticks_of(joint, MADE.zeros[name] + off, angle)


# ------------------------------------------------------------------------------- the zero that follows


@given(
    place=st.integers(0, len(ROBOT.joints) - 1),
    side=st.sampled_from(("lower", "upper")),
    off=st.integers(-100, 100),
    turns=st.integers(-3, 3),
    scatter=st.lists(st.integers(-2, 2), min_size=2, max_size=5),
)
@examples(100)
def test_the_zero_follows_from_the_endstop_position(
    place: int, side: str, off: int, turns: int, scatter: list[int]
) -> None:
    slot = slots(ROBOT)[place]
    stop = slot.joint.stops.endstop_of_side(side)
    assert stop is not None
    entry = FITTING.by_name[slot.name]  # coarse: the truth is `off` beside it
    where = ticks_of(slot.joint, entry.zero_ticks + off, stop)
    counts = [where + each + 4096 * turns for each in scatter]
    fresh = make_endstop_entry(EndstopPlan(slot, side, stop, None, None, None), entry, counts)
    assert abs(fresh.zero_ticks - (entry.zero_ticks + off)) <= 3
    assert fresh.method == "endstop" and fresh.captures == len(counts)
    assert fresh.zero_sigma_ticks <= 2.0 and fresh.proof is None
    downwards = (side == "lower") == (slot.rad_per_tick > 0.0)
    moved, kept = (0, 1) if downwards else (1, 0)
    assert abs(fresh.sweep_ticks[moved] - where) <= 2
    assert fresh.sweep_ticks[kept] == entry.sweep_ticks[kept]


def test_a_stop_that_leaves_no_room_for_the_limits_is_refused() -> None:
    slot = slots(ROBOT)[0]
    entry = FITTING.by_name[slot.name]
    touch = EndstopPlan(slot, "lower", -1.6, None, None, None)
    with pytest.raises(Rejected, match=r"its limits .* beyond its travel"):
        make_endstop_entry(touch, entry, [entry.zero_ticks - 200] * 3)


# ------------------------------------------------------------------------------- the step


def test_an_endstop_zero_is_written_and_the_rest_of_the_file_is_kept(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    counts = [stop_of("head_yaw", "upper", 40) + each for each in (0, 1, -1)]
    daemon = Daemon(ROBOT, file, counts)
    words = ("head_yaw", "--side", "upper", "--yes", "--speed", "0.3", "--times", "3", "--current", "0.23")
    assert _endstop(options(*words), daemon) == DONE  # type: ignore[arg-type]
    after = load_calibration(file, ROBOT)
    assert after.by_name["head_yaw"].zero_ticks == FITTING.by_name["head_yaw"].zero_ticks + 40
    assert after.by_name["head_yaw"].method == "endstop"
    for name in set(ROBOT.names) - {"head_yaw"}:
        assert after.by_name[name] == replace(FITTING.by_name[name])
    how = daemon.driven
    assert how == {"joint": "head_yaw", "side": "upper", "current_share": 0.1, "speed": 0.3, "times": 3}
    methods = [(method, given.get("on")) for method, given in daemon.asked]
    order = [("AcquireLease", None), ("Calibrate", True), ("FindStop", None), ("Calibrate", False)]
    assert [each for each in methods if each in order] == order
    said = capsys.readouterr().out
    for word in ("upper stop at +1.600 rad", "0.3 rad/s", "0.23 A", "10%", "3 times", "limp", "restart"):
        assert word in said


def test_the_robot_file_gives_side_and_current_of_the_endstop_search(tmp_path: Path) -> None:
    text = ROBOT.path.read_text().replace("mjcf: h24.xml", f"mjcf: {ROBOT.mjcf_path}")
    for old, new in OTHERS.items():
        text = text.replace(old, new, 1)
    (tmp_path / "h24.yaml").write_text(text)
    robot = read_robot(tmp_path / "h24.yaml")
    file = save_calibration(FITTING, tmp_path, "one")
    daemon = Daemon(robot, file, [stop_of("l_shoulder_pitch", "upper")] * 2)
    assert _endstop(options("l_shoulder_pitch", "--yes"), daemon) == DONE  # type: ignore[arg-type]
    how = daemon.driven
    assert how is not None and how["side"] == "upper" and how["current_share"] == pytest.approx(0.2 / 2.3)


def test_json_is_one_line_each(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    daemon = Daemon(ROBOT, file, [stop_of("head_yaw", "lower")] * 3)
    assert _endstop(options("head_yaw", "--side", "lower", "--yes", "--json"), daemon) == DONE  # type: ignore[arg-type]
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line.get("phase") for line in lines[:3]] == ["waiting", "approaching", "found"]
    assert lines[3]["zero_ticks"] == FITTING.by_name["head_yaw"].zero_ticks
    assert "written" in lines[4]


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("nobody",), "no joint 'nobody'"),
        (("head_yaw", "--side", "lower"), "no stop"),
    ],
)
def test_a_failed_endstop_search_writes_nothing(file: Path, words: tuple[str, ...], why: str) -> None:
    before = file.read_bytes()
    with pytest.raises(Rejected, match=why):
        _endstop(options(*words, "--yes"), Daemon(ROBOT, file, None))  # type: ignore[arg-type]
    assert file.read_bytes() == before


def test_every_refusal_of_an_endstop_search_precedes_its_motion(file: Path) -> None:
    def refused(daemon: Daemon, *words: str, error: type[Exception] = Rejected) -> str:
        with pytest.raises(error) as told:
            _endstop(options(*words, "--yes"), daemon)  # type: ignore[arg-type]
        assert daemon.driven is None
        return str(told.value)

    counts = [0, 0]
    assert "--side" in refused(Daemon(ROBOT, file, counts), "head_yaw", error=UsageError)
    assert "mode live" in refused(Daemon(ROBOT, file, counts, "mirror"), "head_yaw", "--side", "lower")
    swapped = Daemon(ROBOT, file, counts)
    swapped.device = {"drive_mode": 1}
    assert "drive_mode is 1, was 0" in refused(swapped, "head_yaw", "--side", "lower")
    without = replace(FITTING, joints=FITTING.joints[1:])
    save_calibration(without, file.parent, "one")
    assert "not calibrated, not even coarsely" in refused(
        Daemon(ROBOT, file, counts), "head_yaw", "--side", "lower"
    )
    split = load_robot("h24-split")
    made = save_calibration(calibration(make_spec(split)), file.parent, "split")
    assert "stop_rad" in refused(Daemon(split, made, counts), "head_yaw")


def test_a_negative_confirmation_moves_no_joint(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("sys.stdin.readline", lambda: "n\n", raising=False)
    daemon = Daemon(ROBOT, file, [0, 0])
    with pytest.raises(Rejected, match="nothing moved"):
        _endstop(options("head_yaw", "--side", "lower"), daemon)  # type: ignore[arg-type]
    assert daemon.driven is None


# ------------------------------------------------------------------------------- the turn alone


def test_a_pose_or_an_endstop_tells_a_turn_and_writes_nothing(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = file.read_bytes()
    daemon = Daemon(ROBOT, file, [0, 0])
    by_pose = options("head_yaw", "l_knee", "--pose", "stand", "--at", "head_yaw=0.3", "--yes", step="turn")
    assert _turn(by_pose, daemon) == DONE  # type: ignore[arg-type]
    stands = {"joint_names": ["head_yaw", "l_knee"], "positions": [0.3, 0.6]}
    assert ("LocateJoints", stands) in daemon.asked and daemon.driven is None
    by_stop = options("head_yaw", "--endstop", "--side", "lower", "--yes", step="turn")
    assert _turn(by_stop, daemon) == DONE  # type: ignore[arg-type]
    assert daemon.driven == {"joint": "head_yaw", "side": "lower"}
    assert "head_yaw: its turn is known, it stands at +0.000 rad" in capsys.readouterr().out
    assert file.read_bytes() == before


@pytest.mark.parametrize(
    ("words", "why"),
    [(("head_yaw",), "--pose NAME"), (("head_yaw", "l_knee", "--endstop"), "one joint at a time")],
)
def test_a_turn_without_a_stated_place_is_refused(file: Path, words: tuple[str, ...], why: str) -> None:
    daemon = Daemon(ROBOT, file, [0, 0])
    with pytest.raises(UsageError, match=why):
        _turn(options(*words, "--yes", step="turn"), daemon)  # type: ignore[arg-type]
    assert daemon.driven is None
