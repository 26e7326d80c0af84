"""`twindctl teach` with a stand-in for the daemon: what it asks, writes and reports."""

import argparse
import json
import os
from collections.abc import Iterator
from math import pi, sin
from pathlib import Path
from typing import Any

import pytest

from twind.client import Disconnected
from twind.command_line.keep_torque_off import require_limp
from twind.command_line.trajectory_files import read_trajectory
from twind.command_line.verb import DONE, REFUSED, Rejected, UsageError
from twind.ctl import teach_command
from twind.ctl.teaching import teach_session
from twind.ctl.teaching.key_input import KeyInput
from twind_drivers.clock import FakeClock

NAMES = ("pan", "tilt", "grip")


class StandIn:
    """In place of both connections. `ends_after`: s until the daemon is gone."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.asked: list[str] = []
        self.checked: list[dict[str, Any]] = []
        self.calibrated = dict.fromkeys(NAMES, True)
        self.moves = True
        self.torque = dict.fromkeys(NAMES, False)
        self.armed = False
        self.refusals: list[dict[str, Any]] = []
        self.ends_after = 10.0
        self.check_fails = False
        self.timeout = 0.0
        self.connected = True

    def __enter__(self) -> "StandIn":
        return self

    def __exit__(self, *_: object) -> None: ...

    def call(self, method: str, **how: Any) -> dict[str, Any]:
        self.asked.append(method)
        match method:
            case "GetRobot":
                joints = [{"name": name} for name in NAMES]
                rest = dict.fromkeys(NAMES, 0.0)
                return {"robot": {"joints": joints, "motions": str(self.folder), "poses": {"rest": rest}}}
            case "GetStatus":
                status = {"mode": "mirror", "armed": self.armed, "loop": {"rate_hz": 100.0}}
                return {"status": status, "joints": self._rows(0.0)}
            case "Check" if self.check_fails:
                raise Disconnected("the daemon closed the connection")
            case "Check":
                self.checked.append(how["trajectory"])
                return {"verdict": {"refusals": self.refusals, "warnings": [], "changes": []}}
        return {}

    def stream(self, _method: str, **_how: Any) -> Iterator[dict[str, Any]]:
        for tick in range(round(self.ends_after / 0.01)):
            yield {"time": 50.0 + 0.01 * tick, "mode": "mirror", "joints": self._rows(0.01 * tick)}
        raise Disconnected("the daemon closed the connection")

    def _rows(self, time: float) -> list[dict[str, Any]]:
        at = 0.5 * sin(pi * min(time, 2.0) / 2.0) ** 2 if self.moves else 0.0
        common = {"position": at, "heard": True}
        torque = self.torque
        known = self.calibrated
        return [{"name": name, "torque": torque[name], "calibrated": known[name], **common} for name in NAMES]


@pytest.fixture
def daemon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> StandIn:
    found = StandIn(tmp_path / "motions")
    monkeypatch.setattr(teach_session, "operator", lambda _: found)
    monkeypatch.setattr(teach_session, "observer", lambda _: found)
    return found


def taught(*words: str, keys: bytes = b"", text: bool = False) -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--json", action="store_true")
    teach_command.add_arguments(parser)
    options = parser.parse_args([*([] if text else ["--json"]), *words])
    options.socket = None
    options.verb = "teach"
    reader, writer = os.pipe()
    os.write(writer, keys)
    os.close(writer)
    try:
        return teach_session.teach(options, KeyInput(reader))
    finally:
        os.close(reader)


def report(capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    answer: dict[str, Any] = json.loads(capsys.readouterr().out)
    return answer


def test_the_motion_of_the_hand_is_written(daemon: StandIn, capsys: pytest.CaptureFixture[str]) -> None:
    assert taught("swing", "--seconds", "2.5") == DONE
    motion = read_trajectory(daemon.folder / "swing.json")
    assert motion["joint_names"] == list(NAMES)
    told = report(capsys)
    assert told["ended"] == "after 2.5 s"
    assert told["points"] == len(motion["points"]) <= 10  # type: ignore[arg-type]
    assert told["deviation"] <= 0.01
    assert daemon.checked[-1] == {**motion, "policy": "reject"}
    assert "Calibrate" in daemon.asked  # nobody arms while hands are on the robot


def test_only_the_chosen_joints_are_recorded(daemon: StandIn) -> None:
    daemon.torque["grip"] = daemon.armed = True
    assert taught("swing", "--seconds", "1", "--joints", "[pt]*") == DONE
    assert read_trajectory(daemon.folder / "swing.json")["joint_names"] == ["pan", "tilt"]
    assert "Calibrate" not in daemon.asked  # the others hold: an armed robot has no such state
    assert "AcquireLease" in daemon.asked


def test_a_joint_with_torque_is_refused_by_name(daemon: StandIn) -> None:
    daemon.torque["grip"] = True
    with pytest.raises(Rejected, match="torque is on: grip"):
        taught("swing", "--seconds", "1")
    with pytest.raises(Rejected, match="torque is on: grip"):
        require_limp(daemon, FakeClock(), ["grip"])  # type: ignore[arg-type]


def test_a_joint_without_calibration_is_not_taught(daemon: StandIn) -> None:
    daemon.calibrated["pan"] = False
    with pytest.raises(Rejected, match=r"pan: not calibrated.*twindctl calibrate sweep"):
        taught("swing", "--seconds", "1")
    assert not daemon.folder.exists() and "AcquireLease" not in daemon.asked
    assert taught("swing", "--seconds", "1", "--joints", "tilt") == DONE


def test_a_hand_that_moved_nothing_leaves_no_file(daemon: StandIn) -> None:
    daemon.moves = False
    with pytest.raises(Rejected, match=r"no joint moved by more than 0\.01 rad"):
        taught("swing", "--seconds", "1")
    assert not daemon.folder.exists()


def test_enter_begins_and_ends_it(daemon: StandIn, capsys: pytest.CaptureFixture[str]) -> None:
    assert taught("swing", keys=b"\n") == REFUSED  # it goes on until the daemon is gone
    told = report(capsys)
    assert told["ended"] == "the daemon closed the connection"
    assert told["seconds"] == pytest.approx(9.98)
    with pytest.raises(Rejected, match="no path was recorded: it was ended at once"):
        taught("other", keys=b"\n\n")


def test_without_keys_a_duration_is_needed(daemon: StandIn) -> None:
    with pytest.raises(UsageError, match="--seconds"):
        taught("swing")


def test_a_motion_that_is_there_is_kept(daemon: StandIn) -> None:
    daemon.folder.mkdir()
    (daemon.folder / "swing.json").write_text("mine")
    with pytest.raises(Rejected, match="--force"):
        taught("swing", "--seconds", "1")
    assert (daemon.folder / "swing.json").read_text() == "mine"
    assert "AcquireLease" not in daemon.asked
    assert taught("swing", "--seconds", "1", "--force") == DONE


def test_a_refused_motion_is_written_and_says_so(daemon: StandIn) -> None:
    daemon.refusals = [{"code": "SELF_COLLISION", "joint": None, "message": "hand and head"}]
    assert taught("swing", "--seconds", "2.5") == REFUSED
    assert (daemon.folder / "swing.json").exists()


def test_a_refused_motion_replaces_none_even_by_force(
    daemon: StandIn, capsys: pytest.CaptureFixture[str]
) -> None:
    daemon.folder.mkdir()
    (daemon.folder / "swing.json").write_text("mine")
    daemon.refusals = [{"code": "SELF_COLLISION", "joint": None, "message": "hand and head"}]
    assert taught("swing", "--seconds", "1", "--force") == REFUSED
    assert (daemon.folder / "swing.json").read_text() == "mine"
    assert read_trajectory(Path(report(capsys)["path"]))["joint_names"] == list(NAMES)


def test_the_text_names_what_was_changed_and_the_next_command(
    daemon: StandIn, capsys: pytest.CaptureFixture[str]
) -> None:
    daemon.refusals = [{"code": "TOO_MANY_POINTS", "joint": None, "message": "too many points"}]
    assert taught("swing", "--seconds", "2.5", text=True) == REFUSED
    lines = capsys.readouterr().out
    assert "of 3 joints: " in lines
    assert "play will be refused: TOO_MANY_POINTS" in lines
    assert "--bound" in lines
    assert lines.endswith("next: twindctl mode live, twindctl arm, then twindctl play swing --approach\n")


@pytest.mark.parametrize("lost", ["the recording", "the check"])
def test_a_daemon_that_is_lost_costs_nothing_that_was_recorded(
    daemon: StandIn, lost: str, capsys: pytest.CaptureFixture[str]
) -> None:
    daemon.check_fails = True
    daemon.ends_after = 1.0 if lost == "the recording" else 10.0
    assert taught("swing", "--seconds", "2.5") == REFUSED
    told = report(capsys)
    assert told["verdict"] is None
    assert told["seconds"] == pytest.approx(0.99 if lost == "the recording" else 2.5)
    assert (daemon.folder / "swing.json").exists()


def test_a_motion_that_cannot_be_written_gets_another_folder(
    daemon: StandIn, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    write = teach_session.write_trajectory

    def full(path: Path, *given: Any, **how: Any) -> None:
        if path.parent == daemon.folder:
            raise OSError(28, "No space left on device")
        write(path, *given, **how)

    monkeypatch.setattr(teach_session, "write_trajectory", full)
    assert taught("swing", "--seconds", "1") == REFUSED
    kept = Path(report(capsys)["path"])
    assert kept.parent != daemon.folder
    assert read_trajectory(kept)["joint_names"] == list(NAMES)
