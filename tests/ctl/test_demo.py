"""`twindctl demo` arms its own virtual robot, whatever the first readings after a start are like."""

import argparse
from pathlib import Path
from typing import Any

import pytest

from twind.client.errors import Refused
from twind.command_line.verb import Rejected
from twind.config.robot_file import load_robot
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


def test_the_motions_shown_are_those_of_the_robot() -> None:
    robot = load_robot("pan-tilt")
    motions = demo.load_motions({"motions": str(robot.motions)})
    assert list(motions) == ["look", "nod"]
    assert all(motion["joint_names"] == ["pan", "tilt"] for motion in motions.values())


def test_a_robot_without_motions_is_refused_with_their_folder(tmp_path: Path) -> None:
    with pytest.raises(Rejected, match=f"{tmp_path} holds no trajectory file"):
        demo.load_motions({"motions": str(tmp_path)})


def test_an_unknown_robot_is_refused_before_anything_is_started(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(Rejected, match="no robot of that name"):
        demo.run(argparse.Namespace(seconds=1.0, walk=False, robot="nosuch"))
    assert capsys.readouterr().out == ""
