"""`play` and `move`: delays with their reason, and what they say of a motion that ended early."""

import argparse
import signal
from collections.abc import Iterator
from typing import Any

import pytest

from twind.client import Disconnected
from twind.ctl import motion_commands
from twind.ctl.motion_commands import PLAY, longer_text


def report(phase: str = "succeeded", **fields: Any) -> dict[str, Any]:
    return {"phase": phase, "duration": 9.0, **fields}


def test_a_slowed_motion_reports_its_time_and_its_reason() -> None:
    text = longer_text(report(stretch=1.2, stretched_by=["LOOKAHEAD_COLLISION"]))
    assert text == "; took 10.2 s instead of 9.0 s: slowed near other bodies (LOOKAHEAD_COLLISION)"


def test_a_motion_that_did_not_succeed_is_late() -> None:
    text = longer_text(report("cancelled", stretch=0.5, stretched_by=["OVERTEMP", "LOOP_LATE"]))
    assert text == "; 0.5 s late: slowed for a hot motor (OVERTEMP), ticks were missed (LOOP_LATE)"


def test_a_code_of_a_newer_daemon_stands_alone() -> None:
    assert longer_text(report(stretch=3.0, stretched_by=["NEW"])).endswith("instead of 9.0 s: NEW")


@pytest.mark.parametrize("fields", [{}, {"stretch": None}, {"stretch": 0.0}, {"stretch": 0.04}])
def test_a_motion_in_its_time_needs_no_word(fields: dict[str, Any]) -> None:
    assert longer_text(report(**fields)) == ""
    assert longer_text({"phase": "succeeded"}) == ""


class StandIn:
    """In place of the connection to the daemon; the first motion ends in `phase`."""

    connected = True

    def __init__(self, phase: str) -> None:
        self.phase = phase
        self.sent: list[dict[str, Any]] = []

    def __enter__(self) -> "StandIn":
        return self

    def __exit__(self, *_: object) -> None: ...

    def call(self, method: str, **_how: Any) -> dict[str, Any]:
        return {"joints": [{"name": "pan", "position": -0.2, "goal": None}]} if method == "GetStatus" else {}

    def stream(self, _method: str, trajectory: dict[str, Any]) -> Iterator[dict[str, Any]]:
        self.sent.append(trajectory)
        yield report(self.phase if len(self.sent) == 1 else "succeeded", progress=1.0)


MOTION = {
    "joint_names": ["pan"],
    "points": [{"positions": [0.8], "time_from_start": 0.1}, {"positions": [0.0], "time_from_start": 9.0}],
}


@pytest.mark.parametrize(("phase", "code", "sent"), [("succeeded", 0, 2), ("aborted", 1, 1)])
def test_an_approach_leads_slowly_to_the_first_point_and_must_succeed(
    monkeypatch: pytest.MonkeyPatch, phase: str, code: int, sent: int
) -> None:
    daemon = StandIn(phase)
    monkeypatch.setattr(motion_commands, "operator", lambda _: daemon)
    monkeypatch.setattr(motion_commands, "asked_motion", lambda *_: MOTION)
    options = argparse.Namespace(
        motion="swing", approach=True, retime=False, take=False, json=True, verb="play", socket=None
    )
    assert PLAY.run(options) == code
    way = {"positions": [0.8], "velocities": [0.0], "time_from_start": pytest.approx(2.0)}
    assert daemon.sent == [{"joint_names": ["pan"], "points": [way]}, MOTION][:sent]


def test_a_motion_that_ended_early_shows_where_its_joints_are(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(motion_commands, "operator", lambda _: StandIn("aborted"))
    monkeypatch.setattr(motion_commands, "asked_motion", lambda *_: MOTION)
    options = argparse.Namespace(
        motion="swing", approach=False, retime=False, take=False, json=False, verb="play", socket=None
    )
    assert PLAY.run(options) == 1
    assert capsys.readouterr().out == "aborted at 100%; now at pan -0.200 rad\n"


@pytest.mark.parametrize(
    ("mode", "end"), [("live", ""), ("mirror", "; in the simulation alone: mode mirror")]
)
def test_a_motion_in_mode_mirror_says_that_no_actuator_moved(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], mode: str, end: str
) -> None:
    daemon = StandIn("succeeded")
    monkeypatch.setattr(daemon, "call", lambda *_, **__: {"status": {"mode": mode}})
    monkeypatch.setattr(motion_commands, "operator", lambda _: daemon)
    monkeypatch.setattr(motion_commands, "asked_motion", lambda *_: MOTION)
    options = argparse.Namespace(
        motion="swing", approach=False, retime=False, take=False, json=False, verb="play", socket=None
    )
    assert PLAY.run(options) == 0
    assert capsys.readouterr().out.startswith(f"succeeded at 100%{end}")


def test_a_motion_that_a_fall_ended_shows_the_next_commands(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    daemon = StandIn("aborted")
    fall = {
        "mode": "live",
        "state": "fault",
        "armed": True,
        "faults": [{"code": "FALLING"}],
        "latched": ["FALLING"],
    }
    call = daemon.call

    def answer(method: str, **parameters: Any) -> Any:
        found = call(method, **parameters)
        return found | {"status": fall} if method == "GetStatus" else found

    monkeypatch.setattr(daemon, "call", answer)
    monkeypatch.setattr(motion_commands, "operator", lambda _: daemon)
    monkeypatch.setattr(motion_commands, "asked_motion", lambda *_: MOTION)
    options = argparse.Namespace(
        motion="swing", approach=False, retime=False, take=False, json=False, verb="play", socket=None
    )
    assert PLAY.run(options) == 1
    last = capsys.readouterr().out.splitlines()[-1]
    stopped = "the robot is stopped by FALLING (the robot fell); torque is on; next: "
    assert last.startswith(f"{stopped}`twindctl disarm`")


def test_a_position_that_rounds_to_zero_has_no_sign(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    daemon = StandIn("aborted")
    rows = [{"name": "pan", "position": -1e-5, "goal": None}]
    monkeypatch.setattr(daemon, "call", lambda method, **_: {"joints": rows} if "Get" in method else {})
    assert _play(monkeypatch, daemon) == 1
    assert "now at pan 0.000 rad" in capsys.readouterr().out


def test_after_a_cut_the_next_commands_are_those_of_a_robot_without_torque(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    daemon = StandIn("aborted")
    cut = {"mode": "live", "state": "estop", "faults": [{"code": "ESTOP"}], "latched": ["ESTOP"]}
    statuses = [cut | {"armed": True}, cut | {"armed": False, "torque_on": False}]
    monkeypatch.setattr(
        daemon, "call", lambda method, **_: {"status": statuses.pop(0)} if "Get" in method else {}
    )
    assert _play(monkeypatch, daemon) == 1
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith("the robot is stopped by ESTOP; torque is off; next: find and mend")


def test_ctrl_c_cancels_and_ends_with_its_exit_code(monkeypatch: pytest.MonkeyPatch) -> None:
    daemon = StandIn("cancelled")
    stream = daemon.stream

    def interrupted(method: str, trajectory: dict[str, Any]) -> Iterator[dict[str, Any]]:
        signal.raise_signal(signal.SIGINT)
        yield from stream(method, trajectory)

    monkeypatch.setattr(daemon, "stream", interrupted)
    assert _play(monkeypatch, daemon) == 130


def test_a_daemon_that_ends_in_a_motion_leaves_words_about_what_moves_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    daemon = StandIn("aborted")

    def gone(_method: str, trajectory: dict[str, Any]) -> Iterator[dict[str, Any]]:
        yield report("executing", progress=0.1)
        raise Disconnected("the daemon closed the connection")

    monkeypatch.setattr(daemon, "stream", gone)
    with pytest.raises(Disconnected, match="drive on to their last goal"):
        _play(monkeypatch, daemon)


def _play(monkeypatch: pytest.MonkeyPatch, daemon: StandIn) -> int:
    monkeypatch.setattr(motion_commands, "operator", lambda _: daemon)
    monkeypatch.setattr(motion_commands, "asked_motion", lambda *_: MOTION)
    options = argparse.Namespace(
        motion="swing", approach=False, retime=False, take=False, json=False, verb="play", socket=None
    )
    return PLAY.run(options)
