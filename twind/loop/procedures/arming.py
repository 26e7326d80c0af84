"""Arming: torque on in all joints, or in none; joints may be left limp by request.

Order: device watchdogs armed and read back, goal := present read back, torque on and read back, no joint
jumped. A failure, an interruption or a lost client ends with torque off again. Torque that was on before
stays on when arming fails.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from math import isnan
from typing import Any

import numpy as np

from twind.loop.bus.bus_wait import all_of
from twind.loop.ipc.call_outcome import CallRefusal, CallReply
from twind.loop.procedures.procedure_context import ProcedureContext
from twind.loop.procedures.procedure_runner import Procedure, ProcedureFailed, Steps, ticks
from twind.loop.procedures.torque_readback import torque_inherited
from twind.loop.procedures.torque_switching import (
    beyond_hard_limit,
    error_text,
    held_range,
    say_unconfirmed,
    switch_torque_off,
    take,
)
from twind.robot.arrays import Bools, Floats, spread_over_groups
from twind.robot.finding import Finding, ReasonCode, Verdict
from twind.robot.joint_map import JointMap
from twind.robot.modes import RobotState
from twind.safety.multiturn import expected
from twind.safety.state_machine import RobotEvent
from twind_drivers.bus import BusError

# s, the oldest reading for a goal at torque-on; an older one would be a step (docs/proof.md: 50 ms)
FRESH = 0.05
# ticks a joint may move between reading and torque; more would be a step (docs/proof.md: 2 counts)
STILL = 2.5
UNWATCHED = (
    "armed without a device watchdog that can be read back: if the daemon dies, it drives on to its last goal"
)
FIRST = 1.0  # s to wait for the first temperature and supply voltage, which are read some 5 times a second
# attempts of goal := present on a robot that still swings; without a bound arming would never answer
TRIES = 20
JUMP = 0.05  # rad a joint may move within the first ticks of torque; beyond it zero, sign or goal is wrong


def arm(
    context: ProcedureContext,
    judge: Callable[[float], Verdict],
    edited: Sequence[str],
    limp: Bools,
    now: float,
) -> Procedure:
    """Set goal := present, read it back, switch torque on, read it back, then hold.

    `judge` returns the gate's verdict at a time (s); `edited`: files whose present content differs; `limp`
    (n,): joints that stay without torque.
    """
    refusals = yield from _check_arming_request(judge, now)
    if refusals := (*refusals, *_find_edited_files(edited), *_find_needed_joints(context, limp)):
        return CallRefusal(refusals)
    inherited = torque_inherited(context)
    context.hardware.clear()  # a queued register write or reboot must not reach a robot with torque
    context.condition.change(RobotEvent.ARM)
    try:
        held = yield from _energise(context, limp, inherited)
    except (BusError, ProcedureFailed) as error:
        yield from back_out(context, inherited)
        failed = Finding(ReasonCode.ARM_FAILED, message=error_text(context, error))
        return CallRefusal((error.finding if isinstance(error, ProcedureFailed) else failed,))
    except GeneratorExit:  # the procedure that takes over finds `energising` set and switches torque off
        context.hardware.clear()
        context.condition.change_if(RobotEvent.ARM_FAILED)
        raise
    context.torque.leave_limp(limp)
    take(context, held)
    context.condition.change(RobotEvent.ARMED)
    return CallReply(_joints_and_warnings(context.robot.joints, context.torque.held))


def _joints_and_warnings(joints: JointMap, held: Bools) -> dict[str, Any]:
    """Return the parameters of the reply: joints armed, and those without a watchdog that is read back."""
    unwatched = [joint for joint in joints.unwatched if held[joint]]
    findings = [Finding(ReasonCode.DEVICE_MISMATCH, joint, message=UNWATCHED) for joint in unwatched]
    armed = {"joints": np.flatnonzero(held).tolist()}
    return armed | {"warnings": findings} if findings else armed


def _find_needed_joints(context: ProcedureContext, limp: Bools) -> list[Finding]:
    """Return JOINT_LIMP for joints (n,) that must not stay limp.

    A free-standing robot needs its legs, and joints that share motors have torque together.
    """
    carried = context.robot.carried
    legs = () if carried else np.flatnonzero(limp & context.robot.description.ratings.leg)
    message = "a robot that stands freely needs torque in its legs: do not leave this joint limp"
    found = [Finding(ReasonCode.JOINT_LIMP, int(joint), message=message) for joint in legs]
    groups = context.robot.joints.transmission_groups
    message = "shares motors with a joint that gets torque: leave all of them limp, or none"
    shared = np.flatnonzero(limp & spread_over_groups(~limp, groups))
    return [*found, *(Finding(ReasonCode.JOINT_LIMP, int(joint), message=message) for joint in shared)]


def _check_arming_request(
    judge: Callable[[float], Verdict], now: float
) -> Generator[None, float, tuple[Finding, ...]]:
    """Return the refusals of the gate; wait up to `FIRST` s for the first temperature and supply voltage."""
    refusals = judge(now).refusals
    deadline = now + FIRST
    while refusals and all(map(_unread, refusals)) and now < deadline:
        now = yield
        refusals = judge(now).refusals
    return refusals


def _unread(finding: Finding) -> bool:
    """Check that the refusal only reports a value that was never read (THERMAL_HEADROOM, VOLTAGE_LOW)."""
    value = finding.value
    return (
        finding.code in (ReasonCode.THERMAL_HEADROOM, ReasonCode.VOLTAGE_LOW)
        and value is not None
        and isnan(value)
    )


def _find_edited_files(edited: Sequence[str]) -> list[Finding]:
    """Return CALIB_MISMATCH for files whose present content differs.

    The front reads them: a tick reads no file.
    """
    message = "{} differs from what this daemon uses: `twindctl reload`, or a restart where it says so"
    return [Finding(ReasonCode.CALIB_MISMATCH, message=message.format(path)) for path in edited]


def _energise(context: ProcedureContext, limp: Bools, inherited: bool) -> Generator[None, float, Floats]:
    """Run all steps from the watchdogs to torque read back; return the position (n,) that is held, rad."""
    hardware = context.hardware
    wanted = ~limp
    _require_all_or_none(context, limp)
    # Watchdogs first: a servo with torque and no watchdog would not stop if the daemon died here. The driver
    # sets goal := present of servos with torque as they are cleared: a tripped one refuses goals (e-manual,
    # Bus Watchdog), and the servo would resume its old goal.
    yield from all_of(hardware.prepare(hardware.reachable(present(context, limp)), wanted))
    # The goal is written before torque: at torque-on a servo drives to the goal that its register holds.
    held = yield from _write_present_goals(context, limp)
    _require_undisturbed(context)
    _require_one_turn(context, limp)
    if not inherited:  # torque that was on before stays on when arming fails
        context.torque.begin_energising()
    yield from all_of(hardware.torque(True))
    # Torque needs a few ticks to act; only then a wrong goal shows as movement.
    yield from ticks(3)
    _require_undisturbed(context)
    jump = np.where(wanted, np.abs(context.robot.measured.position - held), 0.0)
    if not (jump <= JUMP).all():
        joint = int(np.argmax(np.nan_to_num(jump, nan=np.inf)))
        message = "jumped at torque-on; torque is off again"
        raise ProcedureFailed.measured(ReasonCode.ARM_FAILED, jump[joint], JUMP, message, joint)
    return held


def _require_one_turn(context: ProcedureContext, limp: Bools) -> None:
    """Raise ProcedureFailed where a servo in position mode would read another turn at torque-on.

    In position mode a servo reads one turn from torque-on (e-manual, "Operating Mode", note). The count that
    is written as its goal must be the one that it reads then.
    """
    turns = context.robot.joints.turns
    readings = context.hardware.readings
    if turns is None:
        return
    count = readings.raw.ticks + readings.shift
    then = expected(readings.raw.ticks, turns)
    beyond = turns.known & turns.falls & (count != then) & ~limp
    if beyond.any():
        joint = int(np.argmax(beyond))
        message = (
            f"would read {then[joint]} at torque-on, not {count[joint]}: position mode covers one turn, and "
            "it is beyond its end; move it inside by hand"
        )
        remedy = context.robot.bound.file.joints[joint].type.lost_turn_remedy
        message += f", or {remedy}" if remedy else ""
        raise ProcedureFailed.measured(ReasonCode.CALIB_MISMATCH, then[joint], count[joint], message, joint)


def _write_present_goals(context: ProcedureContext, limp: Bools) -> Generator[None, float, Floats]:
    """Write goal := present and read it back until the robot hangs still; return the goal (n,), rad.

    The goal of a joint that rests on its mechanical stop, a little beyond its range of goals, is the end of
    that range.
    """
    hardware = context.hardware
    for _ in range(TRIES):
        # The robot moved while the goal was written: such a goal would be a step, so it is taken anew.
        here = present(context, limp)
        held = hardware.quantised(hardware.reachable(here))
        yield from all_of(hardware.write_goals(held))
        moved = np.abs(context.robot.measured.position - here) / hardware.resolution
        moved[limp] = 0.0
        if (moved <= STILL).all():
            return held
    joint = int(np.argmax(np.nan_to_num(moved, nan=np.inf)))
    message = "still moving (ticks): let it hang quiet, then arm again"
    raise ProcedureFailed.measured(ReasonCode.ARM_FAILED, moved[joint], STILL, message, joint)


def _require_undisturbed(context: ProcedureContext) -> None:
    if context.condition.state is not RobotState.ARMING or context.condition.latches:
        message = f"the robot went to {context.condition.state.value} meanwhile"
        raise ProcedureFailed(Finding(ReasonCode.ARM_FAILED, message=message))


def _require_all_or_none(context: ProcedureContext, limp: Bools) -> None:
    unknown = limp & (context.hardware.slow.torque < 0)
    if unknown.any():
        message = "is to stay limp, and its torque was not read"
        raise ProcedureFailed.measured(ReasonCode.ARM_FAILED, -1.0, 0.0, message, int(np.argmax(unknown)))
    on = context.hardware.slow.torque == 1
    if on.any() and not np.array_equal(on, ~limp):
        joint = int(np.argmax(on))
        message = f"torque is on in {int(on.sum())} of {len(on)} joints, this one first: disarm, then arm"
        raise ProcedureFailed.measured(ReasonCode.ARM_FAILED, on.sum(), 0.0, message, joint)


def present(context: ProcedureContext, limp: Bools) -> Floats:
    """Return the measured position (n,), rad: fresh, complete, and where a joint may be held.

    A joint on its mechanical stop reads a little beyond its hard limit: the tolerance is that of the guard.
    `limp` (n,): joints that are not to be held, wherever they are. Raises ProcedureFailed.
    """
    state = context.robot.measured
    age = context.clock.now() - state.time + state.age
    if not (age <= FRESH).all():
        joint = int(np.argmax(age))
        message = "no fresh reading (s): check cable and power"
        raise ProcedureFailed.measured(ReasonCode.HW_DISCONNECTED, age[joint], FRESH, message, joint)
    unknown = ~np.isfinite(state.position)
    if unknown.any():
        message = "its position is unknown: wait until it is read and its turn is known, then arm"
        joint = int(np.argmax(unknown))
        raise ProcedureFailed(Finding(ReasonCode.HW_DISCONNECTED, joint, message=message))
    outside = beyond_hard_limit(context) & ~limp
    if outside.any():
        joint = int(np.argmax(outside))
        value = float(state.position[joint])
        lower, upper = held_range(context)
        bound = float((lower if value < lower[joint] else upper)[joint])
        message = "past the hard limit: move it inside by hand, then arm"
        raise ProcedureFailed.measured(ReasonCode.OUT_OF_LIMIT, value, bound, message, joint)
    return state.position


def back_out(context: ProcedureContext, inherited: bool) -> Steps:
    """Switch torque off again and read it back; torque that was on before arming stays on."""
    context.executor.idle()
    context.hardware.clear()
    if not inherited:
        try:
            yield from switch_torque_off(context)
        except BusError as error:
            say_unconfirmed(context, error)
    context.condition.change_if(RobotEvent.ARM_FAILED)


def give_up(context: ProcedureContext) -> Procedure:
    """End an arming whose client closed its connection before torque was on."""
    yield from back_out(context, inherited=not context.torque.energising)
    return None
