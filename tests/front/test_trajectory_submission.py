"""The front's share of the gate: form, names, tolerances, policy."""

from typing import Any

import numpy as np
import pytest

from twind import link, sealed_memfd
from twind.exceptions import InvalidInput
from twind.front.joint_naming import JointNames
from twind.front.trajectory_submission import (
    SealedTrajectory,
    TrajectoryMessage,
    fields,
    judge,
    message_of,
    policy,
)
from twind.robot.finding import ReasonCode

NAMES = JointNames(["hip", "knee", "ankle"])


def trajectory(**changed: Any) -> TrajectoryMessage:
    points = [{"positions": [0.1, 0.2], "velocities": [0, 0.0], "time_from_start": 1}]
    return message_of({"joint_names": ["ankle", "hip"], "points": points, **changed})


def codes(message: TrajectoryMessage) -> list[ReasonCode]:
    path, wrong = judge(message, NAMES)
    assert (path is None) == bool(wrong)
    return [finding.code for finding in wrong]


def test_a_submitted_trajectory_reaches_the_loop_in_joint_order() -> None:
    tolerances = [{"joint": "hip", "path": 0.1}]
    message = trajectory(start_in=0.5, tolerances=tolerances, goal_time=1.0, append_stop=True)
    path, wrong = judge(message, NAMES)
    assert path is not None
    assert not wrong
    submit = link.Submit(ticket=1, client=2, **fields(message, path, NAMES))
    assert submit.commanded == [0, 2]
    assert submit.tolerances == [(0, 0.1, None)]
    assert (submit.start_in, submit.goal_time, submit.append_stop) == (0.5, 1.0, True)
    with SealedTrajectory(path) as fd:
        there = link.unpack_path(sealed_memfd.unseal(fd), submit, 3)
    assert there.position[0, [0, 2]].tolist() == [0.2, 0.1]
    assert np.isnan(there.position[0, 1])
    assert there.velocity is not None


def test_a_tolerance_of_zero_or_minus_one_reaches_the_loop() -> None:
    tolerances = [{"joint": "hip", "path": 0.0, "goal": -1.0}]
    message = trajectory(tolerances=tolerances)
    path, wrong = judge(message, NAMES)
    assert path is not None
    assert not wrong
    assert fields(message, path, NAMES)["tolerances"] == [(0, 0.0, -1.0)]


@pytest.mark.parametrize(
    ("changed", "code"),
    [
        ({"joint_names": []}, ReasonCode.NO_JOINTS),
        ({"points": []}, ReasonCode.EMPTY),
        ({"joint_names": ["ankle", "toe"]}, ReasonCode.UNKNOWN_JOINT),
        ({"joint_names": ["hip", "hip"]}, ReasonCode.DUP_JOINT),
        ({"joint_names": ["hip"]}, ReasonCode.BAD_SHAPE),
        ({"start_in": -0.1}, ReasonCode.CMD_EXPIRED),
        ({"start_in": 60.1}, ReasonCode.TOO_DISTANT),
        ({"goal_time": -1.0}, ReasonCode.BAD_SCHEMA),
        ({"tolerances": [{"joint": "toe"}]}, ReasonCode.UNKNOWN_JOINT),
        ({"tolerances": [{"joint": "hip"}, {"joint": "hip"}]}, ReasonCode.DUP_JOINT),
        ({"tolerances": [{"joint": "hip", "goal": -0.5}]}, ReasonCode.BAD_SCHEMA),
        ({"tolerances": [{"joint": "hip", "path": float("nan")}]}, ReasonCode.BAD_SCHEMA),
        ({"points": [{"positions": [0, 0], "time_from_start": -1.0}]}, ReasonCode.TIME_ORDER),
    ],
)
def test_an_invalid_trajectory_is_refused_with_its_code(changed: dict[str, Any], code: ReasonCode) -> None:
    assert code in codes(trajectory(**changed))


def test_all_errors_of_a_trajectory_are_reported_at_once() -> None:
    message = trajectory(joint_names=["toe", "hip"], start_in=-1.0, goal_time=-1.0)
    assert codes(message) == [ReasonCode.CMD_EXPIRED, ReasonCode.UNKNOWN_JOINT, ReasonCode.BAD_SCHEMA]


@pytest.mark.parametrize("theirs", ["reject", "retime", None])
def test_a_request_may_be_stricter_than_the_robot_file_never_looser(theirs: str | None) -> None:
    description = {} if theirs is None else {"gate": {"on_velocity": theirs}}
    assert policy(trajectory(), description) == (theirs or "reject")
    assert policy(trajectory(policy="reject"), description) == "reject"
    if theirs == "retime":
        assert policy(trajectory(policy="retime"), description) == "retime"
    else:
        with pytest.raises(InvalidInput, match="stricter"):
            policy(trajectory(policy="retime"), description)
    with pytest.raises(InvalidInput, match="expected one of reject, retime"):
        policy(trajectory(policy="fast"), description)


def test_a_request_may_choose_where_the_robot_file_says_nothing() -> None:
    gate = {"on_velocity": "reject", "request_may_retime": True}
    assert policy(trajectory(), {"gate": gate}) == "reject"
    assert policy(trajectory(policy="retime"), {"gate": gate}) == "retime"
    with pytest.raises(InvalidInput, match=r"write `gate: \{on_velocity: retime\}`"):
        policy(trajectory(policy="retime"), {"gate": gate | {"request_may_retime": False}})


def test_an_unknown_joint_of_a_tolerance_is_reported_with_similar_ones() -> None:
    path, (finding,) = judge(trajectory(tolerances=[{"joint": "ankel", "path": 0.1}]), NAMES)
    assert path is None
    assert finding.code is ReasonCode.UNKNOWN_JOINT
    assert finding.message.startswith("tolerance: no joint 'ankel'; nearest: ankle; ")


@pytest.mark.parametrize(
    "given",
    [{}, {"joint_names": ["hip"], "points": [{"positions": [0.1]}]}, {"joint_names": "hip", "points": []}],
)
def test_message_of_another_shape_is_refused(given: dict[str, Any]) -> None:
    with pytest.raises(InvalidInput) as refused:
        message_of(given)
    assert refused.value.where == "trajectory"


def test_unknown_fields_of_a_message_are_ignored() -> None:
    assert trajectory(colour="red") == trajectory()
