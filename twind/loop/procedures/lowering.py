"""Lowering: the motion of a held robot to its rest pose, and the wait until torque may go off there."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass, replace

import numpy as np

from twind.loop.procedures.procedure_context import ProcedureContext
from twind.loop.procedures.procedure_runner import Steps, ticks
from twind.loop.procedures.torque_readback import REPLIED
from twind.loop.procedures.torque_switching import error_text, joint_names
from twind.motion.motion_layers import choose
from twind.motion.settle import SPEED, settle
from twind.motion.stop_profiles import still
from twind.robot.arrays import Bools, Floats, some
from twind.robot.event_codes import EventCode
from twind.robot.finding import ReasonCode
from twind.robot.modes import Motion
from twind_drivers.bus import BusError

# s from the first packet to torque off (docs/proof.md); a robot that stands freely is damped then
SETTLE = 4.0
WAY = 3.2  # s for the motion to the rest pose, more where the limits need it (docs/reason-codes.md)
LATE = 1.0  # s beyond the end of a longer motion, before it is given up
WAYS = 2  # motions that are tried: a fault on the first one ends it where the robot stands
OBEYED = 6  # ticks that a goal read back may be behind the one being written
LETTING_GO = 10.0  # s from the end of the motion to the end of damping and to torque read back off
ARRIVED = 0.02  # rad from the rest pose, of the goals
NEAR = 0.1  # rad from the rest pose, as measured: a free-standing robot is released only there ...
# rad/s ... and when it has been at rest for so many s
SLOW = 0.05
SLOW_FOR = 0.5


@dataclass(frozen=True, slots=True)
class SettleProfile:
    """Settings of how a robot is lowered."""

    speed: float = SPEED  # share of every limit on the motion, when there is time for it
    way: float = WAY  # s for the motion, more where the limits need it
    within: float = SETTLE  # s from the take-over to torque off; a robot that stands freely is damped then
    whole: bool = False  # True: a robot that cannot be taken over completely keeps its torque
    pose: str = ""  # of the robot file, in which torque goes off; "": the rest pose


USUAL = SettleProfile()


def lower(
    context: ProcedureContext, profile: SettleProfile, extend: Callable[[float], None]
) -> Generator[None, float, bool]:
    """Lower the robot and return True when it rests where torque may go off.

    False: the motion is refused, interrupted or too long, or only damping is allowed any more. `extend`
    requests more time (s) of a service manager that waits for the end of the daemon.
    """
    robot = context.robot
    pose = robot.bound.pose(profile.pose) if profile.pose else robot.rest
    # A travel that was measured may end before the pose: a goal beyond it stops the goals of all joints.
    target = np.clip(pose, robot.limits.lower, robot.limits.upper)
    until = context.clock.now() + profile.within
    for _ in range(WAYS):
        reference = context.executor.reference
        now = context.clock.now()
        if reference is None or context.torque.soft_since is not None or now >= until:
            break
        left = context.torque.limp | ~context.hardware.energised_joints | _half_silent(context)
        if _leg_stays_away(context, left, target, pose):
            return False
        start = choose(left, still(reference.position), reference)
        there = np.where(left, reference.position, target)
        way = settle(start, there, robot.limits, profile.way, profile.speed)
        way = replace(way, commanded=~left)
        refused = context.executor.submit("settle", way)
        if refused is not None:
            message = f"no way to the rest pose: {refused.message}"
            context.reports.event("error", refused.code, message, (refused,))
            return False
        lasts = float(way.time[-1])
        if lasts > profile.within:
            message = f"the way to the rest pose takes {lasts:.1f} s"
            context.reports.event("warning", EventCode.SETTLE, message)
            extend(lasts + LETTING_GO)
            until = now + lasts + LATE if robot.carried else until
        yield from _confirm_begun(context)
        yield from _wait_for_end(context, until)
        if _arrived(context, target, left):
            return robot.carried or (yield from _rests(context, target, until))
    if context.torque.soft_since is None:
        context.reports.event("error", EventCode.SETTLE, "the way to the rest pose came to no end")
    return False


def _half_silent(context: ProcedureContext) -> Bools:
    """Return and report the joints (n,) that stay where they are, as an actuator of theirs is silent.

    Where several turn joints together, the others alone would turn these elsewhere than to the pose.
    """
    age = context.robot.measured.age
    found = np.zeros(len(age), np.bool_)
    for places in context.robot.joints.transmission_groups:
        found[places] = some(~(age[places] <= REPLIED))
    if some(found):
        message = f"{joint_names(context, found)} stay where they are: not all their actuators answer"
        context.reports.event("error", ReasonCode.DEVICE_MISSING, message)
    return found


def _leg_stays_away(context: ProcedureContext, left: Bools, target: Floats, pose: Floats) -> bool:
    """Check for a leg of a free-standing robot that does not come to `pose` (n,) while the other crouches.

    The robot would be driven to its fall, or released beside its rest pose. `left` (n,): joints that are not
    moved; `target` (n,): where the others end.
    """
    robot = context.robot
    if robot.carried:
        return False
    end = np.where(left, robot.measured.position, target)
    away = robot.description.ratings.leg & ~(np.abs(end - pose) <= NEAR)
    found = some(away)
    if found:
        message = f"{joint_names(context, away)} cannot come to the rest pose: no way there on the other leg"
        context.reports.event("error", EventCode.SETTLE, message)
    return found


def _confirm_begun(context: ProcedureContext) -> Steps:
    """Report an e-stop as begun once the servos hold the goals of the last ticks, read back."""
    if not context.torque.stop_begun and (yield from _check_goals_taken(context)):
        context.torque.confirm_stop_begun()


def _wait_for_end(context: ProcedureContext, until: float) -> Steps:
    """Wait for the end of the motion, its interruption, a demand for damping, or `until` (s)."""
    now = yield
    while context.executor.motion is Motion.ACTIVE and now < until and context.torque.soft_since is None:
        now = yield


def _arrived(context: ProcedureContext, target: Floats, left: Bools) -> bool:
    """Check that the goals are at the pose `target` (n,), but for the joints `left` (n,)."""
    reference = context.executor.reference
    if reference is None:
        return False
    arrived = np.abs(reference.position - target) <= ARRIVED
    return bool((arrived | left).all())


def _check_goals_taken(context: ProcedureContext) -> Generator[None, float, bool]:
    """Check that the servos hold the goals of the last ticks: the motion has begun on the devices."""
    yield from ticks(2)
    try:
        held = yield from context.hardware.read_goals()
    except BusError as error:
        message = f"the goals of the way could not be read back: {error_text(context, error)}"
        context.reports.event("error", ReasonCode.BUS_ERRORS, message)
        return False
    robot = context.robot
    if robot.written is None:
        return False
    lag = OBEYED * robot.limits.velocity * robot.period + context.hardware.resolution
    held_joints = context.hardware.energised_joints
    return bool((np.abs(held - robot.written)[held_joints] <= lag[held_joints]).all())


def _rests(context: ProcedureContext, target: Floats, until: float) -> Generator[None, float, bool]:
    """Wait until every joint that is held answers, is near `target` (n,), and is slow for a while.

    False if not by `until` (s).
    """
    now = quiet_since = context.clock.now()
    while now < until and context.torque.soft_since is None:
        state = context.robot.measured
        near = (state.age <= SLOW_FOR) & (np.abs(state.position - target) <= NEAR)
        if not ((near & (np.abs(state.velocity) <= SLOW)) | context.torque.limp).all():
            quiet_since = now
        if now - quiet_since >= SLOW_FOR:
            return True
        now = yield
    context.reports.event("error", EventCode.SETTLE, "not at rest in the rest pose")
    return False
