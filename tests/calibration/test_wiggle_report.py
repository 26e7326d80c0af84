"""The words and the JSON of a verdict on one joint: what is known, and what is not."""

from dataclasses import replace
from typing import Any

import pytest

from tests.support.move_evidence_rig import FRICTION, stays_of
from tests.support.mujoco_servo_rig import WAY
from twind_calibration.wiggling.joint_move import MoveResult
from twind_calibration.wiggling.move_evidence import EncoderObservation, EncoderResponse, answer, weigh
from twind_calibration.wiggling.wiggle_report import WiggleVerdict


def verdict(**changes: Any) -> WiggleVerdict:
    seen = answer(stays_of({0: WAY}), 0, WAY)
    made = WiggleVerdict(
        "a", "main", 1, MoveResult(WAY), seen, weigh(1.0, 1.0, -1.0, FRICTION), "l_foot moves up", None, "abc"
    )
    return replace(made, **changes)


@pytest.mark.parametrize(
    ("changes", "good", "message"),
    [
        ({}, True, "ok   a (main id 1): follows: went +2.01° of +2.01°, its twin +2.01°"),
        ({}, True, "sign and joint agree: measured +1.00 N·m, model +1.00, with the other sign -1.00"),
        ({"weighed": weigh(0.0, 0.01, 0.0, 0.1)}, True, "the sign cannot be told in this pose"),
        ({"weighed": weigh(0.0, 0.01, 0.0, 0.1)}, True, "open a (main id 1): follows"),
        ({"weighed": weigh(0.0, 0.01, 0.0, 0.1), "confirmed": True}, True, "ok   a (main id 1): follows"),
        ({"weighed": None}, True, "by load: not known"),
        ({"weighed": None}, True, "open a (main id 1): follows"),
        ({"weighed": None, "confirmed": False}, False, "LOOK a (main id 1): follows"),
        ({"weighed": weigh(-1.0, 1.0, -1.0, 0.1)}, False, "THE SIGN LOOKS WRONG"),
        ({"weighed": weigh(4.0, 1.0, -1.0, 0.1)}, False, "it fits neither sign"),
        ({"confirmed": False}, False, "l_foot moves up, and back: contradicted"),
        ({"confirmed": True}, True, "l_foot moves up, and back: confirmed"),
        ({"seen": answer(stays_of({0: 0.0}), 0, WAY)}, False, "LOOK a (main id 1): still: went +0.00° of"),
        ({"seen": answer(stays_of({0: 0.0}), 0, WAY)}, False, "it did not move: something holds it"),
        (
            {"seen": answer(stays_of({0: WAY, 2: WAY}), 0, WAY)},
            False,
            "c went +2.01° with it: a second id (12)",
        ),
        (
            {"seen": answer(stays_of({0: WAY}, off=0.03), 0, WAY)},
            False,
            "it stands +1.72° from where it stood",
        ),
        (
            {"gone": MoveResult(WAY, ended=("ESTOP: x",), left=0.01)},
            False,
            "it was ended on the way: ESTOP: x",
        ),
        (
            {"gone": MoveResult(WAY, ended=("ESTOP: x",), left=0.01)},
            False,
            "it holds +0.57° from where it was",
        ),
        (
            {"gone": MoveResult(WAY, refused=("POS_LIMIT: y",)), "seen": None},
            False,
            "the daemon refuses: POS_LIMIT: y",
        ),
        (
            {"seen": EncoderObservation(EncoderResponse.SIMULATED, WAY, 0, 0, 0)},
            True,
            "the gate takes +2.01° and back",
        ),
    ],
)
def test_a_verdict_reports_known_and_unknown_results(
    changes: dict[str, Any], good: bool, message: str
) -> None:
    made = verdict(**changes)
    assert made.is_consistent is good
    assert message in "\n".join(made.lines())
    assert made.to_json()["good"] is good
