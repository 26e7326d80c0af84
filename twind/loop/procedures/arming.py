"""Arming: torque on in all joints, or in none.

Order: device watchdogs armed and read back, goal := present read back, torque on and read back, no joint
jumped. A failure, an interruption or a lost client ends with torque off again. Torque that was on before
stays on when arming fails.
"""

from __future__ import annotations

from collections.abc import Generator
from math import isnan
from typing import TYPE_CHECKING, Any

import numpy as np

from twind import link
from twind.loop.procedures.procedure_runner import Procedure, ProcedureFailed, all_of, ticks
from twind.loop.procedures.torque_switching import error_text, say_unconfirmed, switch_torque_off, take
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import RobotState
from twind.safety.multiturn import expected
from twind.safety.state_machine import RobotEvent
from twind_drivers.bus import BusError

if TYPE_CHECKING:
    from twind.loop.tick.control_loop import Loop
    from twind.robot.arrays import Floats

# s, the oldest reading for a goal at torque-on; an older one would be a step (docs/proof.md: 50 ms)
FRESH = 0.05
# ticks a joint may move between reading and torque; more would be a step (docs/proof.md: 2 counts)
STILL = 2.5
FIRST = 1.0  # s to wait for the first temperature and supply voltage, which are read some 5 times a second
# attempts of goal := present on a robot that still swings; without a bound arming would never answer
TRIES = 20
JUMP = 0.05  # rad a joint may move within the first ticks of torque; beyond it zero, sign or goal is wrong


def arm(loop: Loop, command: link.Arm, now: float) -> Procedure:
    """Set goal := present, read it back, switch torque on, read it back, then hold.

    Replies when the robot is armed, or with the reason why it is not.
    """
    refusals = yield from _check_arming_request(loop, command, now)
    if refusals := (*refusals, *_find_edited_files(command)):
        loop.say.refuse(command, refusals)
        return
    inherited = loop.inherited
    loop.hardware.clear()  # a queued register write or reboot must not reach a robot with torque
    loop.arming_client = command.client
    loop.change(RobotEvent.ARM, now)
    try:
        held = yield from _energise(loop, inherited)
    except (BusError, ProcedureFailed) as error:
        yield from back_out(loop, inherited)
        failed = Finding(ReasonCode.ARM_FAILED, message=error_text(loop, error))
        loop.say.refuse(command, (error.finding if isinstance(error, ProcedureFailed) else failed,))
        return
    except GeneratorExit:  # the procedure that takes over finds `energising` set and switches torque off
        loop.hardware.clear()
        loop.change_if(RobotEvent.ARM_FAILED, loop.clock.now())
        _reply_ended(loop, command)
        raise
    take(loop, held)
    loop.twin.place(held)
    loop.change(RobotEvent.ARMED, loop.clock.now())
    message = "armed without a device watchdog that can be read back: nothing stops it if the daemon dies"
    findings = tuple(
        Finding(ReasonCode.DEVICE_MISMATCH, joint, message=message) for joint in loop.joints.unwatched
    )
    beside: dict[str, Any] = {"warnings": list(findings)} if findings else {}
    loop.say.reply(command, joints=list(range(len(loop.joints))), **beside)
    if findings:
        loop.say.event("warning", ReasonCode.DEVICE_MISMATCH, f"{len(findings)} joints {message}", findings)


def _check_arming_request(
    loop: Loop, command: link.Arm, now: float
) -> Generator[None, float, tuple[Finding, ...]]:
    """Return the refusals of the gate; wait up to `FIRST` s for the first temperature and supply voltage."""
    refusals = loop.may_arm(command.client, now).refusals
    deadline = now + FIRST
    loop.arming_client = command.client
    while refusals and all(map(_unread, refusals)) and now < deadline:
        try:
            now = yield
        except GeneratorExit:
            _reply_ended(loop, command)
            raise
        refusals = loop.may_arm(command.client, now).refusals
    return refusals


def _unread(finding: Finding) -> bool:
    """Check that the refusal only reports a value that was never read (THERMAL_HEADROOM, VOLTAGE_LOW)."""
    value = finding.value
    return (
        finding.code in (ReasonCode.THERMAL_HEADROOM, ReasonCode.VOLTAGE_LOW)
        and value is not None
        and isnan(value)
    )


def _reply_ended(loop: Loop, command: link.Arm) -> None:
    why = next(iter(loop.latches.values()), None)
    what = "something more urgent" if why is None else f"{why.code}: {why.message}"
    loop.say.error(command, "Busy", what=f"arming was ended by {what}")


def _find_edited_files(command: link.Arm) -> list[Finding]:
    """Return CALIB_MISMATCH for files whose present content differs.

    The front reads them: a tick reads no file.
    """
    message = "{} differs from what this daemon uses: `twindctl reload`, restart it, or restore the file"
    return [Finding(ReasonCode.CALIB_MISMATCH, message=message.format(path)) for path in command.edited]


def _energise(loop: Loop, inherited: bool) -> Generator[None, float, Floats]:
    """Run all steps from the watchdogs to torque read back; return the position (n,) that is held, rad."""
    hardware = loop.hardware
    _require_all_or_none(loop)
    # Watchdogs first: a servo with torque and no watchdog would not stop if the daemon died here. The driver
    # sets goal := present while they are cleared: a tripped one refuses goals (e-manual, Bus Watchdog), and
    # the servo would resume its old goal.
    yield from all_of(hardware.prepare(present(loop)))
    # The goal is written before torque: at torque-on a servo drives to the goal that its register holds.
    held = yield from _write_present_goals(loop)
    _require_undisturbed(loop)
    _require_one_turn(loop)
    if not inherited:  # torque that was on before stays on when arming fails
        loop.torque.begin_energising()
    yield from all_of(hardware.torque(True))
    # Torque needs a few ticks to act; only then a wrong goal shows as movement.
    yield from ticks(3)
    _require_undisturbed(loop)
    jump = np.abs(loop.measured.position - held)
    if not (jump <= JUMP).all():
        joint = int(np.argmax(np.nan_to_num(jump, nan=np.inf)))
        message = "jumped at torque-on; torque is off again"
        raise ProcedureFailed.measured(ReasonCode.ARM_FAILED, jump[joint], JUMP, message, joint)
    return held


def _require_one_turn(loop: Loop) -> None:
    """Raise ProcedureFailed where a servo in position mode would read another turn at torque-on.

    In position mode a servo reads one turn from torque-on (e-manual, "Operating Mode", note). The count that
    is written as its goal must be the one that it reads then.
    """
    turns = loop.joints.turns
    readings = loop.hardware.readings
    if turns is None:
        return
    count = readings.raw.ticks + readings.shift
    then = expected(readings.raw.ticks, turns)
    beyond = turns.known & turns.falls & (count != then)
    if beyond.any():
        joint = int(np.argmax(beyond))
        message = (
            f"would read {then[joint]} at torque-on, not {count[joint]}: position mode covers one turn, and "
            "it is beyond its end; move it inside by hand, or set homing_offset (20) to 0 and calibrate"
        )
        raise ProcedureFailed.measured(ReasonCode.CALIB_MISMATCH, then[joint], count[joint], message, joint)


def _write_present_goals(loop: Loop) -> Generator[None, float, Floats]:
    """Write goal := present and read it back until the robot hangs still; return the goal (n,), rad."""
    hardware = loop.hardware
    for _ in range(TRIES):
        # The robot moved while the goal was written: such a goal would be a step, so it is taken anew.
        held = hardware.quantised(present(loop))
        yield from all_of(hardware.write_goals(held))
        moved = np.abs(loop.measured.position - held) / hardware.resolution
        if (moved <= STILL).all():
            return held
    joint = int(np.argmax(np.nan_to_num(moved, nan=np.inf)))
    message = "still moving (ticks): let it hang quiet, then arm again"
    raise ProcedureFailed.measured(ReasonCode.ARM_FAILED, moved[joint], STILL, message, joint)


def _require_undisturbed(loop: Loop) -> None:
    if loop.state is not RobotState.ARMING or loop.latches:
        message = f"the robot went to {loop.state.value} meanwhile"
        raise ProcedureFailed.measured(ReasonCode.ARM_FAILED, 0.0, 0.0, message)


def _require_all_or_none(loop: Loop) -> None:
    on = loop.hardware.slow.torque == 1
    if on.any() and not on.all():
        joint = int(np.argmax(on))
        message = f"torque is on in {int(on.sum())} of {len(on)} joints, this one first: disarm, then arm"
        raise ProcedureFailed.measured(ReasonCode.ARM_FAILED, on.sum(), 0.0, message, joint)


def present(loop: Loop) -> Floats:
    """Return the measured position (n,), rad: fresh, complete and inside the hard limits.

    Raises ProcedureFailed.
    """
    state = loop.measured
    limits = loop.limits
    age = loop.clock.now() - state.time + state.age
    if not (age <= FRESH).all():
        joint = int(np.argmax(age))
        message = "no fresh reading (s): check cable and power"
        raise ProcedureFailed.measured(ReasonCode.HW_DISCONNECTED, age[joint], FRESH, message, joint)
    inside = (state.position >= limits.hard_lower) & (state.position <= limits.hard_upper)
    if not inside.all():
        joint = int(np.argmin(inside))
        value = float(state.position[joint])
        low = value < limits.hard_lower[joint]
        bound = float((limits.hard_lower if low else limits.hard_upper)[joint])
        message = "move it inside by hand, then arm"
        raise ProcedureFailed.measured(ReasonCode.OUT_OF_LIMIT, value, bound, message, joint)
    return state.position


def back_out(loop: Loop, inherited: bool) -> Procedure:
    """Switch torque off again and read it back; torque that was on before arming stays on."""
    loop.executor.idle()
    loop.hardware.clear()
    if not inherited:
        try:
            yield from switch_torque_off(loop)
        except BusError as error:
            say_unconfirmed(loop, error)
    loop.change_if(RobotEvent.ARM_FAILED, loop.clock.now())


def give_up(loop: Loop) -> Procedure:
    """End an arming whose client closed its connection before torque was on."""
    yield from back_out(loop, inherited=not loop.torque.energising)
