"""The procedures that change torque: arm, disarm, settle after a fault, e-stop, shutdown.

Arming is all or nothing: device watchdogs armed and read back, goal := present read back, torque read back,
nobody jumped. A failure on the way ends with torque off again. Torque is never left on by accident, and
never taken by accident from a robot that was found energised.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import TYPE_CHECKING

import numpy as np

from twind import link
from twind.loop.procedures import Procedure, Rank, all_of, ticks
from twind.motion.settle import settle
from twind.robot.finding import Code, Finding
from twind.robot.modes import Mode, Motion, State
from twind.safety.states import Event
from twind_drivers.bus import BusError

if TYPE_CHECKING:
    from twind.loop.tick import Loop
    from twind.robot.arrays import Floats

FRESH = 0.05  # s, the oldest reading that a goal at torque-on may rest on (W4)
STILL = 2.5  # ticks a joint may have moved between the reading and the torque (W4: 2 counts)
TRIES = 20  # goal := present, for a robot that still swings
JUMP = 0.05  # rad a joint may move within the first ticks of torque
SETTLE = 4.0  # s for the way to the rest pose (docs/safety.md)
LATE = 1.0  # s more than planned before torque goes off anyway
SLOW = 0.05  # rad/s: a free-standing robot is let go only when it has come to rest ...
SLOW_FOR, SLOW_MOST = 1.0, 5.0  # s ... for this long, or after this long at the latest


class ArmFailed(Exception):
    """Arming stopped half-way; the finding says where."""

    def __init__(self, finding: Finding) -> None:
        super().__init__(finding.message)
        self.finding = finding


# ----------------------------------------------------------------------------------------------- arm


def arm(loop: Loop, command: link.Arm, now: float) -> Procedure:
    """Goal := present, read back, then torque, read back, then hold. Answers when armed, or why not."""
    verdict = loop.may_arm(command.client, now)
    if verdict.refusals:
        loop.refuse(command, verdict.refusals)
        return
    inherited = loop.inherited
    loop.change(Event.ARM, now)
    try:
        position = yield from _energise(loop)
    except (BusError, ArmFailed) as error:
        yield from _back_out(loop, inherited)
        loop.change(Event.ARM_FAILED, loop.clock.now())
        found = (
            error.finding if isinstance(error, ArmFailed) else Finding(Code.ARM_FAILED, message=str(error))
        )
        loop.refuse(command, (found,))
        return
    except GeneratorExit:
        loop.hardware.clear()  # no torque-on of ours may leave after this
        if loop.state is State.ARMING:
            loop.change(Event.ARM_FAILED, loop.clock.now())
        loop.error(command, "Busy", what="arming was ended by something more urgent")
        raise
    loop.armed, loop.inherited, loop.energising = True, False, False
    loop.twin.place(position)
    loop.executor.begin(position)
    loop.written = position  # goal := present was written and read back
    loop.change(Event.ARMED, loop.clock.now())
    loop.reply(command, joints=list(range(len(loop.joints))))


def _energise(loop: Loop) -> Generator[None, float, Floats]:
    """Everything from the watchdogs to torque read back; the position (n,) that is now held."""
    hardware = loop.hardware
    present = _present(loop)
    yield from all_of(hardware.prepare(present))
    for _ in range(TRIES):
        present = _present(loop)
        held = hardware.quantised(present)
        yield from all_of(hardware.aim(held))
        moved = np.abs(loop.measured.position - held) / hardware.resolution
        if (moved <= STILL).all():
            break
    else:
        joint = int(np.nanargmax(moved))
        raise ArmFailed(
            Finding(
                Code.ARM_FAILED,
                joint,
                value=float(moved[joint]),
                bound=STILL,
                message="still moving: let it hang quiet, then arm again",
            )
        )
    loop.energising = not loop.inherited  # what was found energised is not ours to take away
    yield from all_of(hardware.torque(True))
    yield from ticks(3)
    jump = np.abs(loop.measured.position - held)
    if not (jump <= JUMP).all():
        joint = int(np.argmax(np.nan_to_num(jump, nan=np.inf)))
        raise ArmFailed(
            Finding(
                Code.ARM_FAILED,
                joint,
                value=float(jump[joint]),
                bound=JUMP,
                message="jumped at torque-on; torque is off again",
            )
        )
    return held


def _present(loop: Loop) -> Floats:
    """The position (n,) to begin from: fresh, whole and inside the hard limits, or ArmFailed."""
    state, limits = loop.measured, loop.limits
    now = loop.clock.now()
    age = now - state.time + state.age
    if not (age <= FRESH).all():
        joint = int(np.argmax(age))
        raise ArmFailed(
            Finding(
                Code.HW_DISCONNECTED, joint, value=float(age[joint]), bound=FRESH, message="no fresh reading"
            )
        )
    inside = (state.position >= limits.hard_lower) & (state.position <= limits.hard_upper)
    if not inside.all():
        joint = int(np.argmin(inside))
        value = float(state.position[joint])
        bound = limits.hard_lower[joint] if value < limits.hard_lower[joint] else limits.hard_upper[joint]
        raise ArmFailed(
            Finding(
                Code.OUT_OF_LIMIT,
                joint,
                value=value,
                bound=float(bound),
                message="move it inside by hand, then arm",
            )
        )
    return state.position


def _back_out(loop: Loop, inherited: bool) -> Procedure:
    """Those just energised are let go again; what was found energised keeps its torque."""
    loop.executor.idle()
    loop.hardware.clear()
    if not inherited:
        try:
            yield from all_of(loop.hardware.torque(False))
        except BusError as error:
            loop.event("error", Code.TORQUE_MISMATCH, f"torque could not be read back off: {error}")
            return
    loop.energising = False


# ----------------------------------------------------------------------------------------------- release


def disarm(loop: Loop, command: link.Disarm, now: float) -> Procedure:
    """SETTLE, then torque off. Answers when torque is read back off. Inhibited: torque off alone."""
    latched = loop.state in (State.FAULT, State.ESTOP, State.INHIBITED)
    if not loop.energised:
        loop.reply(command, state=loop.state.value)
        return
    if not latched:
        loop.change(Event.SETTLE, now)
    try:
        yield from release(loop, now)
    except BusError as error:
        loop.error(command, "BusFailed", bus="", message=str(error))
        return
    except GeneratorExit:
        loop.error(command, "Busy", what="disarming was ended by something more urgent")
        raise
    if not latched:
        loop.change(Event.SETTLED, loop.clock.now())
    loop.reply(command, state=loop.state.value)


def release(loop: Loop, now: float) -> Procedure:
    """Down to the rest pose if we hold the robot, then torque off and read back. Raises BusError."""
    if loop.armed and not loop.inhibited:
        try:
            yield from _settle(loop, now)
        except BusError as error:
            loop.event("error", Code.INTERNAL, f"settling was cut short: {error}")
    yield from loosen(loop)


def _settle(loop: Loop, now: float) -> Procedure:
    if (loop.hardware.slow.watchdog == 255).any():  # tripped servos refuse goals: clear, goal := present
        present = loop.measured.position.copy()
        loop.executor.idle()
        yield from all_of(loop.hardware.prepare(present, first=True))
        loop.executor.begin(present)
        loop.written = present  # goal := present was written and read back
    start_settling(loop)
    path_end = now + SETTLE * 4 + LATE
    while loop.executor.motion is Motion.ACTIVE and now < path_end:
        now = yield
    if loop.support == "free":
        yield from _come_to_rest(loop, now)


def start_settling(loop: Loop) -> None:
    """Begin the way to the rest pose, from wherever the reference is."""
    reference = loop.executor.reference
    if reference is not None:
        loop.executor.submit("settle", settle(reference, loop.rest, loop.limits, SETTLE))


def _come_to_rest(loop: Loop, now: float) -> Procedure:
    quiet_since, until = now, now + SLOW_MOST
    while now < until and now - quiet_since < SLOW_FOR:
        now = yield
        if not (np.abs(loop.measured.velocity) <= SLOW).all():
            quiet_since = now


def loosen(loop: Loop) -> Procedure:
    """Torque off, twice, read back. Raises BusError naming who did not confirm."""
    loop.executor.idle()
    loop.hardware.clear()
    try:
        yield from all_of(loop.hardware.torque(False))
    finally:
        loop.armed = loop.inherited = loop.energising = False


# ----------------------------------------------------------------------------------------------- e-stop


def estop(loop: Loop, command: link.EStop, now: float) -> Procedure:
    """Stop, by level. Answers when the first effect is confirmed on the bus; with `more`, again when done."""
    loop.latch(Finding(Code.ESTOP, message=command.reason or f"e-stop ({command.level})"))
    loop.change(Event.ESTOP, now)
    if loop.mode is not Mode.LIVE or not loop.energised:
        loop.executor.stop()
        loop.twin.halt()
        loop.reply(command, state=loop.state.value, torque_off=loop.torque_off, done=True)
        return
    if command.level == "cut" or not loop.armed:
        yield from _cut(loop, command)
        return
    start_settling(loop)
    yield from ticks(2)
    loop.reply(command, continues=command.more, state=loop.state.value, torque_off=False, done=False)
    try:
        yield from release(loop, loop.clock.now())
    except BusError as error:
        loop.event("error", Code.TORQUE_MISMATCH, str(error))
    if command.more:
        loop.reply(command, state=loop.state.value, torque_off=loop.torque_off, done=True)


def _cut(loop: Loop, command: link.EStop) -> Procedure:
    loop.executor.idle()
    for writer in loop.hardware.writers:
        writer.cut()
    yield  # the packets left with this tick's exchange
    try:
        yield from loosen(loop)
    except BusError as error:
        loop.error(command, "BusFailed", bus="", message=f"torque is not confirmed off: {error}")
        return
    loop.reply(command, state=loop.state.value, torque_off=loop.torque_off, done=True)


def fault(loop: Loop, now: float) -> Procedure:
    """After a fault that cannot be held: settle and let go. The state stays FAULT until a reset."""
    try:
        yield from release(loop, now)
    except BusError as error:
        loop.event("error", Code.TORQUE_MISMATCH, f"torque could not be read back off: {error}")


def shutdown(loop: Loop, now: float) -> Procedure:
    """SIGTERM: lower the robot if we hold it, then end. What was found energised, or may not be written
    to any more, is left as it is."""
    if loop.armed and not loop.inhibited:
        if loop.state not in (State.FAULT, State.ESTOP):
            loop.change(Event.SETTLE, now)
        yield from fault(loop, now)
        if loop.state is State.SETTLING:
            loop.change(Event.SETTLED, loop.clock.now())
    elif loop.energising:  # told in the middle of arming
        yield from fault(loop, now)
    loop.finished = True


RANKS = {"settle": Rank.ESTOP, "cut": Rank.CUT}
