"""`twindctl demo` arms its own virtual robot, whatever the first readings after a start are like."""

from typing import Any

import pytest

from twind.client.errors import Refused
from twind.ctl import demo

LATE = {"code": "LATENCY_BLOCK", "value": 0.104, "bound": 0.1, "message": "state age + bus round trip"}


class BusyDaemon:
    """Answers `Arm` with a refusal for some times, as a daemon on a machine that still compiles does."""

    def __init__(self, refusals: int) -> None:
        self.refusals = refusals
        self.calls: list[str] = []

    def call(self, method: str) -> dict[str, Any]:
        self.calls.append(method)
        if method == "Arm" and self.calls.count("Arm") <= self.refusals:
            raise Refused("io.twind.Control.Refused", {"findings": [LATE]})
        return {"joints": ["head_yaw"]}


@pytest.fixture(autouse=True)
def _without_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo, "AGAIN", 0.0)


def test_a_refused_arming_is_tried_again_with_the_lease_and_its_reason_is_printed(
    capsys: pytest.CaptureFixture[str],
) -> None:
    daemon = BusyDaemon(refusals=2)
    assert demo.arm_robot(daemon) == ["head_yaw"]  # type: ignore[arg-type]
    assert daemon.calls == ["AcquireLease", "Arm"] * 3
    assert capsys.readouterr().out.count("LATENCY_BLOCK") == 2


def test_an_arming_that_is_refused_for_too_long_is_reported_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo, "ARMING", 0.0)
    with pytest.raises(Refused):
        demo.arm_robot(BusyDaemon(refusals=10**6))  # type: ignore[arg-type]
