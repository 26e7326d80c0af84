"""Verbs of one call say what the robot goes on to do, and that a call without a robot succeeded."""

import argparse
from contextlib import AbstractContextManager
from typing import Any

import pytest

from twind.command_line import verb
from twind.ctl import single_call_commands
from twind.ctl.single_call_commands import DISARM, MARK, RESET
from twind.robot.recovery_steps import UNKNOWN

OPTIONS = argparse.Namespace(socket=None, json=False, codes=[])


class CallClient(AbstractContextManager["CallClient"]):
    """Stand-in for a connection whose calls have this outcome."""

    def __init__(self, outcome: dict[str, Any] | BaseException) -> None:
        self.outcome = outcome

    def __exit__(self, *_: object) -> None:
        """Nothing to close."""

    def call(self, _method: str, **_parameters: Any) -> dict[str, Any]:
        if isinstance(self.outcome, BaseException):
            raise self.outcome
        return self.outcome


def test_ctrl_c_says_that_the_daemon_goes_on_disarming(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(verb, "operator", lambda _: CallClient(KeyboardInterrupt()))
    with pytest.raises(KeyboardInterrupt):
        DISARM.run(OPTIONS)
    told = capsys.readouterr().err
    assert "goes on disarming" in told and "estop --cut" in told


@pytest.mark.parametrize(("was_open", "text"), [(False, "no episode was open"), (True, ""), (None, "")])
def test_an_end_without_an_episode_says_so(
    was_open: bool | None, text: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    answer = {"sequence": 3} if was_open is None else {"sequence": 3, "was_open": was_open}
    monkeypatch.setattr(verb, "operator", lambda _: CallClient(answer))
    options = argparse.Namespace(**vars(OPTIONS), kind="end", task=None, success=None, text=None)
    assert MARK.run(options) == 0
    told = capsys.readouterr().out
    assert told.startswith("marked: end") and (text in told) and ("episode" in told) == bool(text)


@pytest.mark.parametrize(
    ("state", "mode", "torque_on", "text"),
    [
        ("disconnected", "live", None, "no robot is connected"),
        ("connected", "live", False, "state connected"),
        ("connected", "mirror", None, "state connected"),
        ("connected", "live", None, f"state connected; {UNKNOWN}"),
    ],
)
def test_a_reset_says_that_it_is_done_and_when_torque_is_not_known(
    state: str,
    mode: str,
    torque_on: bool | None,
    text: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    status = {"mode": mode, "armed": False, "inherited": False, "torque_on": torque_on}
    client = CallClient({"state": state, "status": status})
    monkeypatch.setattr(single_call_commands, "operator", lambda _: client)
    assert RESET.run(OPTIONS) == 0
    assert capsys.readouterr().out == f"reset: done; {text}\n"
