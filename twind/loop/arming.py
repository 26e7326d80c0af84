"""Arming: torque on, all or nothing.

Device watchdogs armed and read back, goal := present read back, torque on and read back, nobody jumped. Any
failure, interruption or lost client on the way ends with torque off again. What was found energised keeps
its torque when arming fails.
"""

from __future__ import annotations

from collections.abc import Generator
from math import isnan
from typing import TYPE_CHECKING, Any

import numpy as np

from twind import link
from twind.loop.procedures import Procedure, all_of, ticks
from twind.loop.torque import error_text, say_unconfirmed, switch_torque_off, take
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import RobotState
from twind.safety.multiturn import expected
from twind.safety.state_machine import RobotEvent
from twind_drivers.bus import BusError

if TYPE_CHECKING:
    from twind.loop.tick import Loop
    from twind.robot.arrays import Floats

FRESH = 0.05  # s, the oldest reading that a goal at torque-on may rest on (W4)
STILL = 2.5  # ticks a joint may have moved between the reading and the torque (W4: 2 counts)
FIRST = 1.0  # s that the first reading of temperature and supply is waited for
TRIES = 20  # goal := present, for a robot that still swings
JUMP = 0.05  # rad a joint may move within the first ticks of torque


class ArmingFailed(Exception):
    """Arming stopped half-way; the finding says where."""

    def __init__(self, code: ReasonCode, joint: int | None, value: float, bound: float, message: str) -> None:
        super().__init__(message)
        self.finding = Finding(code, joint, value=value, bound=bound, message=message)


def arm(loop: Loop, command: link.Arm, now: float) -> Procedure:
    """Goal := present, read back, then torque, read back, then hold. Answers when armed, or why not."""
    refusals = yield from _check_arming_request(loop, command, now)
    if refusals := (*refusals, *_edited(command)):
        loop.say.refuse(command, refusals)
        return
    inherited = loop.inherited
    loop.hardware.clear()  # a register write or a reboot that waits must not land on a robot with torque
    loop.arming_client = command.client
    loop.change(RobotEvent.ARM, now)
    try:
        held = yield from _energise(loop, inherited)
    except (BusError, ArmingFailed) as error:
        yield from back_out(loop, inherited)
        failed = Finding(ReasonCode.ARM_FAILED, message=error_text(loop, error))
        loop.say.refuse(command, (error.finding if isinstance(error, ArmingFailed) else failed,))
        return
    except GeneratorExit:  # what took over finds `energising` set, and lets go
        loop.hardware.clear()
        loop.change_if(RobotEvent.ARM_FAILED, loop.clock.now())
        _say_ended(loop, command)
        raise
    take(loop, held)
    loop.twin.place(held)
    loop.change(RobotEvent.ARMED, loop.clock.now())
    message = "armed without a watchdog of its own that can be read back: if the daemon dies, nobody stops it"
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
    """What the gate refuses. Heat and supply are read some 5 times a second: the first time is waited for."""
    refusals = loop.may_arm(command.client, now).refusals
    deadline = now + FIRST
    loop.arming_client = command.client
    while refusals and all(map(_unread, refusals)) and now < deadline:
        try:
            now = yield
        except GeneratorExit:
            _say_ended(loop, command)
            raise
        refusals = loop.may_arm(command.client, now).refusals
    return refusals


def _unread(finding: Finding) -> bool:
    """Refused for a reading that never came yet (THERMAL_HEADROOM)."""
    value = finding.value
    return (
        finding.code in (ReasonCode.THERMAL_HEADROOM, ReasonCode.VOLTAGE_LOW)
        and value is not None
        and isnan(value)
    )


def _say_ended(loop: Loop, command: link.Arm) -> None:
    why = next(iter(loop.latches.values()), None)
    what = "something more urgent" if why is None else f"{why.code}: {why.message}"
    loop.say.error(command, "Busy", what=f"arming was ended by {what}")


def _edited(command: link.Arm) -> list[Finding]:
    """CALIB_MISMATCH: the files' present content counts. The front reads them: a tick reads no file."""
    message = "{} is not what this daemon goes by: `twindctl reload`, restart it, or restore the file"
    return [Finding(ReasonCode.CALIB_MISMATCH, message=message.format(path)) for path in command.edited]


def _energise(loop: Loop, inherited: bool) -> Generator[None, float, Floats]:
    """Everything from the watchdogs to torque read back; the position (n,) that is now held."""
    hardware = loop.hardware
    _require_all_or_none(loop)
    yield from all_of(hardware.prepare(present(loop)))
    held = yield from _aimed(loop)
    _require_undisturbed(loop)
    _require_one_turn(loop)
    loop.energising = not inherited  # what was found energised is not ours to take away
    yield from all_of(hardware.torque(True))
    yield from ticks(3)
    _require_undisturbed(loop)
    jump = np.abs(loop.measured.position - held)
    if not (jump <= JUMP).all():
        joint = int(np.argmax(np.nan_to_num(jump, nan=np.inf)))
        message = "jumped at torque-on; torque is off again"
        raise ArmingFailed(ReasonCode.ARM_FAILED, joint, float(jump[joint]), JUMP, message)
    return held


def _require_one_turn(loop: Loop) -> None:
    """A servo in position mode reads one turn from torque-on: that must be the one it was calibrated on, for
    what was written as its goal is what it will read then (e-manual, "Operating Mode", note)."""
    turns = loop.joints.turns
    readings = loop.hardware.readings
    if turns is None:
        return
    count = readings.raw.ticks + readings.shift
    then = expected(readings.raw.ticks, turns)
    other = turns.known & turns.falls & (count != then)
    if other.any():
        joint = int(np.argmax(other))
        message = (
            f"would read {then[joint]} at torque-on, not {count[joint]}: position mode knows one turn, and "
            "it stands beyond its end; move it inside by hand, or set homing_offset (20) to 0 and calibrate"
        )
        raise ArmingFailed(ReasonCode.CALIB_MISMATCH, joint, float(then[joint]), float(count[joint]), message)


def _aimed(loop: Loop) -> Generator[None, float, Floats]:
    """Goal := present, read back, of a robot that hangs quiet; the goal (n,)."""
    hardware = loop.hardware
    for _ in range(TRIES):
        held = hardware.quantised(present(loop))
        yield from all_of(hardware.write_goals(held))
        moved = np.abs(loop.measured.position - held) / hardware.resolution
        if (moved <= STILL).all():
            return held
    joint = int(np.argmax(np.nan_to_num(moved, nan=np.inf)))
    message = "still moving (ticks): let it hang quiet, then arm again"
    raise ArmingFailed(ReasonCode.ARM_FAILED, joint, float(moved[joint]), STILL, message)


def _require_undisturbed(loop: Loop) -> None:
    if loop.state is not RobotState.ARMING or loop.latches:
        raise ArmingFailed(
            ReasonCode.ARM_FAILED, None, 0.0, 0.0, f"the robot went to {loop.state.value} meanwhile"
        )


def _require_all_or_none(loop: Loop) -> None:
    on = loop.hardware.slow.torque == 1
    if on.any() and not on.all():
        joint = int(np.argmax(on))
        message = f"torque is on in {int(on.sum())} of {len(on)} joints, this one first: disarm, then arm"
        raise ArmingFailed(ReasonCode.ARM_FAILED, joint, float(on.sum()), 0.0, message)


def present(loop: Loop) -> Floats:
    """The position (n,) to begin from: fresh, whole and inside the hard limits, or ArmFailed."""
    state = loop.measured
    limits = loop.limits
    age = loop.clock.now() - state.time + state.age
    if not (age <= FRESH).all():
        joint = int(np.argmax(age))
        message = "no fresh reading (s): check cable and power"
        raise ArmingFailed(ReasonCode.HW_DISCONNECTED, joint, float(age[joint]), FRESH, message)
    inside = (state.position >= limits.hard_lower) & (state.position <= limits.hard_upper)
    if not inside.all():
        joint = int(np.argmin(inside))
        value = float(state.position[joint])
        low = value < limits.hard_lower[joint]
        bound = float((limits.hard_lower if low else limits.hard_upper)[joint])
        raise ArmingFailed(ReasonCode.OUT_OF_LIMIT, joint, value, bound, "move it inside by hand, then arm")
    return state.position


def back_out(loop: Loop, inherited: bool) -> Procedure:
    """Those just energised are let go again, read back; what was found energised keeps its torque."""
    loop.executor.idle()
    loop.hardware.clear()
    if not inherited:
        try:
            yield from switch_torque_off(loop)
        except BusError as error:
            say_unconfirmed(loop, error)
    loop.energising = False
    loop.change_if(RobotEvent.ARM_FAILED, loop.clock.now())


def give_up(loop: Loop) -> Procedure:
    """Whoever asked for torque is gone before it was there."""
    yield from back_out(loop, inherited=not loop.energising)
