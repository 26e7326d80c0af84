"""A falling robot folds into its pose, and a stop is latched before it begins. On scripted buses."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.procedure_rig import PLACE, REST, WHY, ProcedureRig
from twind.loop.procedures.procedure_runner import Priority
from twind.robot.fall_settings import FallReaction, FallSettings
from twind.robot.finding import Finding, ReasonCode

FALLING = Finding(ReasonCode.FALLING, value=0.9, bound=0.8, message="rad: it falls")
CROUCH = PLACE - 0.3


def standing() -> ProcedureRig:
    rig = ProcedureRig()
    rig.hold()
    rig.robot.bound.pose = {"crouch": CROUCH, "rest": REST}.__getitem__
    return rig


@pytest.fixture
def rig() -> ProcedureRig:
    return standing()


def lowered(rig: ProcedureRig, why: Finding, fall: Any) -> tuple[list[float], float]:
    """Lower a robot with these settings for a fall: where torque went off, and after how many s."""
    rig.robot.bound.file.fall = fall
    rig.own(Priority.FAULT, lambda: rig.release.fault((why,)))
    took = rig.until_done()
    assert rig.requests()[-1] == "torque False"
    return rig.robot.measured.position.tolist(), took


def test_a_robot_that_falls_folds_into_the_pose_of_its_settings(rig: ProcedureRig) -> None:
    there, _ = lowered(rig, FALLING, FallSettings(FallReaction.FOLD, pose="crouch"))
    assert there == pytest.approx(CROUCH.tolist(), abs=0.02)


@pytest.mark.parametrize(
    ("why", "fall"),
    [
        (WHY, FallSettings(FallReaction.FOLD, pose="crouch")),
        (FALLING, FallSettings(FallReaction.HOLD, pose="crouch")),
        (FALLING, FallSettings(FallReaction.SOFT, pose="crouch")),
        (FALLING, None),
    ],
)
def test_any_other_robot_goes_to_its_rest_pose(
    rig: ProcedureRig, why: Finding, fall: FallSettings | None
) -> None:
    there, _ = lowered(rig, why, fall)
    assert there == pytest.approx(REST.tolist(), abs=0.02)


def test_a_fold_takes_half_the_time_of_the_usual_way() -> None:
    took = {}
    for reaction in (FallReaction.FOLD, FallReaction.HOLD):
        rig = standing()
        _, took[reaction] = lowered(rig, FALLING, FallSettings(reaction, pose="rest"))
    assert took[FallReaction.FOLD] < 0.6 * took[FallReaction.HOLD]


def test_a_fall_among_several_causes_folds_the_robot(rig: ProcedureRig) -> None:
    rig.robot.bound.file.fall = FallSettings(FallReaction.FOLD, pose="crouch")
    rig.own(Priority.FAULT, lambda: rig.release.fault((WHY, FALLING)))
    rig.until_done()
    assert rig.robot.measured.position == pytest.approx(CROUCH, abs=0.02)


# --------------------------------------------------------------------------------------------- requests


@pytest.mark.parametrize(("level", "rank"), [("settle", Priority.ESTOP), ("cut", Priority.CUT)])
def test_a_stop_that_is_requested_is_latched_with_its_reason_and_begins(
    rig: ProcedureRig, level: str, rank: Priority
) -> None:
    rig.release.request_stop(level, "a button was pressed")
    latched = rig.condition.latches[ReasonCode.ESTOP]
    assert (latched.code, latched.message) == (ReasonCode.ESTOP, "a button was pressed")
    assert rig.procedures.rank is rank and rig.torque.stop_level == level


@pytest.mark.parametrize(
    ("ends", "torque", "begins"),
    [(True, 0, False), (True, -1, True), (True, 1, True), (False, 0, True)],
)
def test_the_end_of_a_daemon_whose_torque_is_read_off_is_not_put_off_by_a_stop(
    ends: bool, torque: int, begins: bool
) -> None:
    rig = ProcedureRig()
    rig.hardware.slow = SimpleNamespace(torque=np.full(3, torque, np.int8), watchdog=np.zeros(3, np.int16))
    rig.condition.stop_wanted = ends
    rig.release.request_stop("settle", "a button was pressed")
    assert ReasonCode.ESTOP in rig.condition.latches
    assert (rig.procedures.rank is Priority.ESTOP) == begins
    assert (rig.torque.stop_level == "settle") == begins
