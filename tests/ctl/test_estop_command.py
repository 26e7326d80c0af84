"""`twindctl estop` prints what the daemon reports, and the next step."""

import argparse
from contextlib import AbstractContextManager
from typing import Any

import pytest

from twind.ctl import estop


class EStopClient(AbstractContextManager["EStopClient"]):
    """Replies to `EStop` as a daemon whose torque is `torque_off`."""

    def __init__(self, torque_off: bool | None) -> None:
        self._torque_off = torque_off

    def __exit__(self, *_: object) -> None:
        """Nothing to close."""

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        assert (method, parameters["level"]) == ("EStop", "settle")
        return {"state": "estop", "torque_off": self._torque_off, "done": True}


@pytest.mark.parametrize(
    ("torque_off", "torque", "next_step"),
    [
        (True, "torque is off", "next: find and mend the cause, then `twindctl reset`"),
        (
            False,
            "torque is on",
            "next: wait until torque is off, then find and mend the cause, then `twindctl reset`",
        ),
        (
            None,
            "torque unknown",
            "next: keep clear until `twindctl status` shows no silent joint, then `twindctl reset`",
        ),
    ],
)
def test_an_estop_prints_the_next_step(
    torque_off: bool | None,
    torque: str,
    next_step: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(estop, "connected", lambda *_: EStopClient(torque_off))
    options = argparse.Namespace(cut=False, reason=None, json=False)
    assert estop.ESTOP.run(options) == 0
    assert capsys.readouterr().out.splitlines() == [f"e-stop (settle): state estop, {torque}", next_step]
