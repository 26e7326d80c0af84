"""Only limits of a path lead to a smaller motion; every other refusal ends an excitation and a tuning."""

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.described_joint import JOINT
from twind.client import Refused
from twind.identification.live_excitation import PATH_LIMITS, SMALLER, excite_robot
from twind.identification.step_bench import StepBench
from twind.robot.finding import ReasonCode

OTHERS = sorted(set(ReasonCode) - PATH_LIMITS)


class CodedRefusalRobot:
    """An armed robot that refuses its motions with given codes; the motion after the last of them is made."""

    def __init__(self, *refusals: tuple[str, ...]) -> None:
        self.status = {"mode": "live"}
        self.armed = True
        self.limits = {"elbow": (-1.0, 1.0)}
        self.joints = {"elbow": SimpleNamespace(goal=0.0, temperature=30.0)}
        self.refusals = list(refusals)
        self.reaches: list[float] = []  # rad, largest goal of each motion
        self.durations: list[float] = []  # s, of each path

    def follow(self, joints: Any, points: Any, times: Any, *, retime: bool) -> None:
        self.reaches.append(float(abs(points).max()))
        self.durations.append(float(times[-1]))
        self._answer()

    def submit(self, trajectory: dict[str, Any]) -> None:
        self.reaches.append(abs(trajectory["points"][0]["positions"][0]))
        self._answer()

    def _answer(self) -> None:
        if self.refusals:
            codes = self.refusals.pop(0)
            raise Refused("io.twind.Control.Refused", {"findings": [{"code": code} for code in codes]})


class SilentClient:
    """An observer that receives one state."""

    def stream(self, *_: object, **__: object) -> Iterator[dict[str, Any]]:
        yield {"time": 1.0}

    def close(self) -> None: ...


def excite(robot: CodedRefusalRobot) -> list[Any]:
    return list(excite_robot(robot, SilentClient(), {"joints": [JOINT]}, ["elbow"], 0.4))  # type: ignore[arg-type]


def step(robot: CodedRefusalRobot) -> object:
    bench = StepBench(robot, SilentClient, {"elbow": JOINT}, {"p": 800.0}, 0.2)  # type: ignore[arg-type]
    return bench.step("elbow")


def test_each_motion_is_reported_before_it_begins() -> None:
    robot = CodedRefusalRobot()
    robot.joints["wrist"] = robot.joints["elbow"]
    steps: list[tuple[str, float, int]] = []

    def report(text: str, share: float, seconds: float | None = None) -> None:
        assert seconds is not None and seconds > 0.0
        steps.append((text, share, len(robot.reaches)))

    described = {"joints": [JOINT, JOINT | {"name": "wrist"}]}
    excite_robot(robot, SilentClient(), described, ["elbow", "wrist"], 0.4, report)  # type: ignore[arg-type]
    texts = ["moves elbow (1 of 3)", "moves wrist (2 of 3)", "moves all joints together (3 of 3)"]
    assert [(text, made) for text, _, made in steps] == list(zip(texts, range(3), strict=True))
    ends = np.cumsum(robot.durations)
    assert [share for _, share, _ in steps] == pytest.approx([0.0, ends[0] / ends[2], ends[1] / ends[2]])
    assert robot.durations[2] < robot.durations[0]  # all joints together move less far


@pytest.mark.parametrize("code", sorted(PATH_LIMITS))
def test_a_path_beyond_a_limit_is_tried_again_smaller(code: str) -> None:
    robot = CodedRefusalRobot((code,), (code, "POS_LIMIT"))
    assert excite(robot)
    assert robot.reaches == pytest.approx([0.4 * share for share in SMALLER[:3]])


@pytest.mark.parametrize("code", OTHERS)
def test_any_other_refusal_ends_the_excitation_after_this_motion(code: str) -> None:
    robot = CodedRefusalRobot((code,))
    with pytest.raises(Refused):
        excite(robot)
    assert len(robot.reaches) == 1


@pytest.mark.parametrize("codes", [("POS_LIMIT", "ESTOP_LATCHED"), ("A_NEW_CODE",), ()])
def test_a_limit_beside_another_reason_or_an_unknown_reason_ends_it_too(codes: tuple[str, ...]) -> None:
    robot = CodedRefusalRobot(codes)
    with pytest.raises(Refused):
        excite(robot)
    assert len(robot.reaches) == 1


@pytest.mark.parametrize("code", ["ESTOP_LATCHED", "FAULT_LATCHED", "LEASE_MISSING", "NOT_ARMED", "BUSY"])
def test_a_tuning_asks_for_no_smaller_step_after_such_a_refusal(code: str) -> None:
    robot = CodedRefusalRobot((code,))
    with pytest.raises(Refused):
        step(robot)
    assert len(robot.reaches) == 1
