"""Findings and replies leave the front with names and words."""

import json
from math import inf, nan

import pytest

from tests.support.loop_stand_in import briefing
from twind.front.joint_naming import JointNames
from twind.front.state_cache import StateCache
from twind.link import Event
from twind.protocol import CONTROL, load
from twind.protocol.idl import StructType
from twind.robot.finding import Finding, ReasonCode

NAMES = JointNames(["hip", "knee"])


@pytest.mark.parametrize(
    ("finding", "message"),
    [
        (
            Finding(ReasonCode.POS_LIMIT, 1, 3, 0.4, 2.9, 2.5),
            "knee, point 3 (0.4 s): position 2.9 rad, bound 2.5 rad",
        ),
        (
            Finding(ReasonCode.VEL_LIMIT, 0, None, 1.5, inf, 4.0),
            "hip, at 1.5 s: velocity inf rad/s, bound 4 rad/s",
        ),
        (Finding(ReasonCode.LEASE_MISSING, message="take it first"), "take it first"),
        (Finding(ReasonCode.BUSY), "BUSY"),
        (
            Finding(ReasonCode.START_JUMP, 0, value=0.2, bound=0.05, message="move there first"),
            "hip: distance from where the motion starts 0.2 rad, bound 0.05 rad; move there first",
        ),
        (Finding(ReasonCode.OUT_OF_LIMIT, 0, value=nan, bound=2.7), "hip: position unknown"),
        (Finding(ReasonCode.BAD_SHAPE, 7, value=3, bound=2), "joint 7: value 3, bound 2"),
        (Finding(ReasonCode.BUS_ERRORS, value=0.05, bound=0.05, message="bus a: 5 %"), "bus a: 5 %"),
    ],
)
def test_a_finding_message_gives_joint_point_value_and_bound(finding: Finding, message: str) -> None:
    assert NAMES.finding(finding)["message"] == message


def test_a_finding_off_the_link_reads_like_one_of_ours() -> None:
    ours = Finding(ReasonCode.POS_LIMIT, 1, 3, 0.4, 2.9, 2.5, "x")
    theirs = {
        "code": "POS_LIMIT",
        "joint": 1,
        "point": 3,
        "time": 0.4,
        "value": 2.9,
        "bound": 2.5,
        "message": "x",
    }
    assert NAMES.finding(ours) == NAMES.finding(theirs)


def test_every_index_of_a_reply_is_named() -> None:
    finding = {"code": "STEP_LIMIT", "joint": 0, "value": 1.0}
    reply = {
        "joints": [1, 0],
        "findings": [finding],
        "changes": [finding],
        "verdict": {"refusals": [finding], "warnings": []},
        "state": "armed",
    }
    named = NAMES.reply(reply)
    assert named["joints"] == ["knee", "hip"]
    assert named["state"] == "armed"
    assert [named[key][0]["joint"] for key in ("findings", "changes")] == ["hip", "hip"]
    assert named["verdict"]["refusals"][0]["joint"] == "hip"
    assert named["verdict"]["changes"] == []


@pytest.mark.parametrize(
    "fields",
    [{}, {"id": "m1", "phase": "aborted"}, {"before": "armed", "cause": "estop", "stop": "cut"}],
)
def test_an_event_has_all_fields_of_the_interface_and_null_where_one_does_not_apply(
    fields: dict[str, str],
) -> None:
    event = Event(time=1.0, sequence=1, level="info", code="TEST", message="x", **fields)  # type: ignore[arg-type]
    made = json.loads(StateCache(briefing(2)).event(event))
    known = load(CONTROL).types["Event"]
    assert isinstance(known, StructType) and set(made) == set(known.fields)
    assert {key: made[key] for key in ("id", "phase", "before", "cause", "stop") if made[key]} == fields
