"""`play` and `move` say by how much and why a motion took longer than its path."""

import argparse
from collections.abc import Iterator
from typing import Any

import pytest

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
