"""Goals of FollowJointTrajectory in the daemon's form, and their outcomes in the form of their clients."""

from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.bridge.ros.action_goal_conversion import (
    CODES,
    as_bytes,
    outcome,
    places,
    seconds,
    tolerances,
    unserved,
)
from twind.ros import JOINT_TRAJECTORY, decode

PHASES = ("refused", "succeeded", "cancelled", "replaced", "aborted", "lost", "dropped")


def moment(sec: int = 0, nanosec: int = 0) -> SimpleNamespace:
    return SimpleNamespace(sec=sec, nanosec=nanosec)


def tolerance(name: str, position: float) -> SimpleNamespace:
    return SimpleNamespace(name=name, position=position)


@given(phase=st.sampled_from(PHASES), asked=st.booleans(), code=st.sampled_from([*CODES, "POS_LIMIT", ""]))
def test_only_what_arrived_or_was_cancelled_by_its_own_client_is_successful(
    phase: str, asked: bool, code: str
) -> None:
    findings = [{"code": code, "message": "why"}] if code else []
    number, _ = outcome({"phase": phase, "findings": findings}, asked=asked)
    assert (number == 0) == (phase == "succeeded" or (phase == "cancelled" and asked))
    assert -5 <= number <= 0


@pytest.mark.parametrize(
    ("code", "number"),
    [("UNKNOWN_JOINT", -2), ("CMD_EXPIRED", -3), ("PATH_TOLERANCE", -4), ("GOAL_TOLERANCE", -5), ("X", -1)],
)
def test_the_code_is_that_of_the_first_reason_that_has_one(code: str, number: int) -> None:
    findings = [{"code": "POS_LIMIT", "message": "too far"}, {"code": code, "message": "why"}]
    assert outcome({"phase": "aborted", "findings": findings}, asked=False) == (
        number,
        f"POS_LIMIT: too far; {code}: why",
    )


def test_without_a_finding_the_words_are_the_message() -> None:
    assert outcome({"phase": "lost", "message": "no daemon"}, asked=False) == (-1, "no daemon")
    assert outcome({"phase": "replaced"}, asked=False)[1]


def test_tolerances_of_a_joint_are_one_row() -> None:
    path = [tolerance("knee", 0.1), tolerance("hip", -1.0)]
    goal = [tolerance("knee", 0.0)]
    assert tolerances(path, goal) == [
        {"joint": "knee", "path": 0.1, "goal": 0.0},
        {"joint": "hip", "path": -1.0},
    ]


def test_every_unserved_goal_field_is_named() -> None:
    assert unserved(SimpleNamespace()) == ""
    empty = SimpleNamespace(joint_names=[], points=[])
    assert unserved(SimpleNamespace(multi_dof_trajectory=empty, component_path_tolerance=[])) == ""
    given = SimpleNamespace(joint_names=["base"], points=[])
    assert unserved(SimpleNamespace(multi_dof_trajectory=given)) == "multi_dof_trajectory"
    assert unserved(SimpleNamespace(component_goal_tolerance=[1])) == "component_goal_tolerance"


def test_an_encoded_goal_keeps_its_times_and_positions() -> None:
    point = SimpleNamespace(
        positions=[0.1], velocities=[], accelerations=[], effort=[], time_from_start=moment(1, 500_000_000)
    )
    header = SimpleNamespace(stamp=moment(5, 6), frame_id="base")
    data = as_bytes(SimpleNamespace(header=header, joint_names=["knee"], points=[point]))
    message = decode(JOINT_TRAJECTORY, data)
    assert message["header"] == {"stamp": {"sec": 5, "nanosec": 6}, "frame_id": "base"}
    assert message["joint_names"] == ["knee"]
    assert message["points"][0]["positions"] == [0.1]
    assert message["points"][0]["time_from_start"] == {"sec": 1, "nanosec": 500_000_000}
    assert seconds(point.time_from_start) == 1.5


def state(mode: str, **joint: Any) -> dict[str, Any]:
    return {
        "mode": mode,
        "joints": [{"name": "knee", "goal": 1.0, "position": 0.5, "simulated": 0.9} | joint],
    }


def test_the_actual_position_follows_the_mode() -> None:
    assert places(state("live"), ["knee"]) == ([1.0], [0.5], [0.5])
    assert places(state("sim"), ["knee"]) == ([1.0], [0.9], [pytest.approx(0.1)])


def test_an_unknown_joint_position_suppresses_the_feedback_of_all_joints() -> None:
    assert places(state("live", position=None), ["knee"]) is None
    assert places(state("live"), ["knee", "tail"]) is None
