"""Torque release: disarm, fault, shutdown, e-stop.

Each lowers the robot to its rest pose where it can be held, then switches torque off, twice, and reads it
back. Only an explicit cut skips the motion. A motion that does not end is damped (`damping`) before torque
goes off. A procedure reports torque as read back; what could not be read back is reported as unknown.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from twind import link
from twind.loop.procedures import damping
from twind.loop.procedures.procedure_runner import Priority, Procedure, all_of, ticks
from twind.loop.procedures.torque_switching import (
    beyond_hard_limit,
    error_text,
    joint_names,
    say_unconfirmed,
    switch_torque_off,
    take,
)
from twind.motion.settle import SPEED, settle
from twind.robot.arrays import every, some
from twind.robot.event_codes import EventCode
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode, Motion
from twind.safety.state_machine import RobotEvent
from twind_drivers.bus import BusError, NoReply

if TYPE_CHECKING:
    from twind.loop.tick.control_loop import Loop
    from twind.robot.arrays import Bools, Floats

# s from the first packet to torque off (docs/proof.md); a robot that stands freely is damped then
SETTLE = 4.0
WAY = 3.2  # s for the motion to the rest pose, more where the limits need it (docs/reason-codes.md)
LATE = 1.0  # s beyond the end of a longer motion, before it is given up
WAYS = 2  # motions that are tried: a fault on the first one ends it where the robot stands
OBEYED = 6  # ticks that a goal read back may be behind the one being written
LETTING_GO = 10.0  # s from the end of the motion to the end of damping and to torque read back off
AWAITED = 1.5  # s that an ending daemon waits for a lost bus with torque of its own
ARRIVED = 0.02  # rad from the rest pose, of the goals
NEAR = 0.1  # rad from the rest pose, as measured: a free-standing robot is released only there ...
# rad/s ... and when it has been at rest for so many s
SLOW = 0.05
SLOW_FOR = 0.5
# s to wait for the turn of a joint; s, the age of a reading that makes the wait worthwhile
KNOWN = 0.5
RECENT = 0.1
RANKS = {"settle": Priority.ESTOP, "cut": Priority.CUT}


@dataclass(frozen=True, slots=True)
class SettleProfile:
    """Settings of how a robot is lowered."""

    speed: float = SPEED  # share of every limit on the motion, when there is time for it
    way: float = WAY  # s for the motion, more where the limits need it
    within: float = SETTLE  # s from the take-over to torque off; a robot that stands freely is damped then
    whole: bool = False  # True: a robot that cannot be taken over completely keeps its torque


USUAL = SettleProfile()


def disarm(loop: Loop, command: link.Disarm, now: float) -> Procedure:
    """Lower the robot, then switch torque off. Replies when torque is read back off."""
    if not loop.energised:
        _reply_disarmed(loop, command)
        return
    loop.change_if(RobotEvent.SETTLE, now)
    try:
        yield from release(loop, Finding(ReasonCode.NOT_ARMED, message="the robot was disarmed"))
    except BusError as error:
        loop.say.error(command, "BusFailed", bus="", message=error_text(loop, error))
    except GeneratorExit:
        loop.say.error(command, "Busy", what="disarming was ended by something more urgent")
        raise
    else:
        loop.change_if(RobotEvent.SETTLED, loop.clock.now())
        _reply_disarmed(loop, command)
        return
    # `inherited` and `torque` report the devices that are still on
    loop.change_if(RobotEvent.SETTLED, loop.clock.now())


def _reply_disarmed(loop: Loop, command: link.Disarm) -> None:
    """Answer a disarm: success, unless a bus is closed and the torque on it is not known."""
    closed = [port for port in loop.hardware.ports if port.reader is None]
    if loop.mode is Mode.LIVE and closed:
        message = f"{closed[0].trouble or 'the bus is not open'}; whether torque is on there is not known"
        loop.say.error(command, "BusFailed", bus=closed[0].name, message=message)
    else:
        loop.say.reply(command, state=loop.state.value)


def fault(loop: Loop, now: float, why: tuple[Finding, ...] = ()) -> Procedure:
    """Settle or damp a robot that cannot be held, then release it. A latched state stays until a reset."""
    latched = next(iter(why or loop.latches.values()), Finding(ReasonCode.FAULT_LATCHED, message="a fault"))
    loop.change_if(RobotEvent.SETTLE, now)
    yield from _down(loop, latched)
    loop.change_if(RobotEvent.SETTLED, loop.clock.now())


def _down(loop: Loop, why: Finding) -> Procedure:
    try:
        yield from release(loop, why)
    except BusError as error:
        say_unconfirmed(loop, error)


def shutdown(loop: Loop, now: float) -> Procedure:
    """Handle SIGTERM: lower the robot if this daemon has torque on, then end.

    Torque that was found on, or may not be written any more, stays as it is. A lost bus with torque of this
    daemon is waited for.
    """
    until = now + AWAITED
    while loop.torque.pending_restore and not loop.hardware.connected and now < until:
        now = yield
    if (
        loop.torque.armed or loop.torque.energising or (loop.torque.pending_restore and loop.torque_on)
    ) and not loop.torque.inhibited:
        loop.change_if(RobotEvent.SETTLE, now)
        yield from _down(loop, Finding(ReasonCode.NOT_ARMED, message="the daemon ends: the robot is lowered"))
        loop.change_if(RobotEvent.SETTLED, loop.clock.now())
    until = loop.clock.now() + AWAITED
    while loop.homing.owed is not None and loop.clock.now() < until:
        yield  # the servo of an end-stop search is restored
    loop.homing.report_pending_restore()
    loop.finished = True


def stop(loop: Loop, level: str, now: float) -> None:
    """Begin an e-stop, unless one as hard is under way.

    While it is latched, it begins again for every bus that comes back with torque on.
    """
    loop.torque.latch_stop(level)
    rank = RANKS[level]
    if loop.procedures.rank is None or loop.procedures.rank < rank:
        loop.torque.begin_stop()
        loop.procedures.own(rank, lambda: estop(loop, level, now))


def estop(loop: Loop, level: str, now: float) -> Procedure:
    """Stop, by level. `Loop.stops` replies to the calls: when the stop has begun, and when it is over."""
    loop.change(RobotEvent.ESTOP, now, stop=level)
    loop.executor.stop("aborted", (loop.latches[ReasonCode.ESTOP],))
    if loop.mode is not Mode.LIVE or not loop.hardware.writers:
        loop.twin.halt()
        return
    try:
        if level == "cut":
            yield from switch_torque_off(loop)
        else:
            yield from release(loop, loop.latches[ReasonCode.ESTOP])
    except BusError as error:
        say_unconfirmed(loop, error)


# ----------------------------------------------------------------------------------------------- the parts


def release(loop: Loop, why: Finding, profile: SettleProfile = USUAL) -> Procedure:
    """Lower the robot to the rest pose if it can be held, then switch torque off and read it back.

    Raises BusError. A motion under way ends as aborted, for the reason `why`. A robot that does not come to
    rest is damped. With `manner.whole` torque stays on where not every device took the goals over; BusError
    names the devices.
    """
    loop.executor.stop("aborted", (why,))
    loop.hardware.clear()  # a procedure that ends here may have begun to restore the servos' stiffness
    try:
        held = not loop.torque.inhibited and (yield from _held(loop, profile))
        if held and not (yield from _settled(loop, profile)):
            yield from damping.damp(loop)
    except BusError as error:
        if profile.whole and not loop.torque.armed:
            raise
        message = f"the way to the rest pose was cut short: {error_text(loop, error)}"
        loop.say.event("error", ReasonCode.BUS_ERRORS, message)
    # Whatever failed above, torque off is still sent: an error on the way must not leave torque on.
    yield from switch_torque_off(loop)


def _held(loop: Loop, profile: SettleProfile) -> Generator[None, float, bool]:
    """Hold the robot, or take over torque that was found on or whose watchdog tripped.

    False: it has no torque, or was being energised; then there is nothing to lower.
    """
    held = loop.hardware.energised_joints
    tripped = loop.hardware.slow.watchdog == 255
    if loop.torque.armed and loop.torque.soft_since is not None:
        return True  # it sinks: to clear tripped watchdogs would restore its stiffness
    if loop.torque.armed and held.any() and not (held & tripped).any():
        yield from _rejoined(loop)
        return True
    if loop.torque.energising or not loop.torque_on:
        return False
    yield from _wait_for_turns(loop)
    (here, located), stepped = _where_it_is(loop), beyond_hard_limit(loop)
    # a joint that holds well goes on: a goal at its measured position would make it sag
    if loop.torque.armed and loop.written is not None:
        well = held & ~tripped
        here = np.where(well, loop.written, here)
        located = located | well
        stepped = stepped & ~well
    if some(stepped):
        _leave(loop, stepped, profile)
        return False
    if not every(located):
        _leave_out(loop, ~located, profile)
        if not some(located):
            return False
    loop.executor.idle()
    loop.hardware.clear()
    try:
        yield from all_of(loop.hardware.prepare(here, located))  # clears watchdogs with goal := present
    # the other devices took it over: to lower those is better than to drop the robot
    except NoReply as error:
        if profile.whole:
            raise
        message = f"lowered although a device did not answer: {error_text(loop, error)}"
        loop.say.event("error", ReasonCode.DEVICE_MISSING, message)
    take(loop, here)
    return True


def _leave(loop: Loop, stepped: Bools, profile: SettleProfile) -> None:
    """Report that joints (n,) past their hard limits are not taken over: to hold them would be a step.

    Raises BusError where the whole robot is wanted and it is not armed.
    """
    message = f"to hold {joint_names(loop, stepped)} inside the hard limits would be a step"
    if profile.whole and not loop.torque.armed:
        raise BusError(message)
    joint = int(np.flatnonzero(stepped)[0])
    found = Finding(
        ReasonCode.OUT_OF_LIMIT, joint, value=float(loop.measured.position[joint]), message=message
    )
    report = f"{message}: torque goes off where the robot stands; support it"
    loop.say.event("error", ReasonCode.OUT_OF_LIMIT, report, (found,))


def _leave_out(loop: Loop, nowhere: Bools, profile: SettleProfile) -> None:
    """Report that joints (n,) of unknown place get no goal: it could be a turn away.

    Raises BusError where the whole robot is wanted and it is not armed.
    """
    message = f"the position of {joint_names(loop, nowhere)} is unknown"
    if profile.whole and not loop.torque.armed:
        raise BusError(message)
    joint = int(np.flatnonzero(nowhere)[0])
    found = Finding(ReasonCode.CALIB_MISMATCH, joint, message=message)
    report = f"{message}: it gets no goal, and torque goes off where it stands; support it"
    loop.say.event("error", ReasonCode.CALIB_MISMATCH, report, (found,))


def _wait_for_turns(loop: Loop) -> Procedure:
    """Wait at most `KNOWN` s for the turn check of joints that answered within the last `RECENT` s.

    Such joints are still unchecked when the daemon has just begun.
    """
    until = loop.clock.now() + KNOWN
    while some(loop.identity.verified.unjudged & (loop.measured.age <= RECENT)) and loop.clock.now() < until:
        yield


def _rejoined(loop: Loop) -> Procedure:
    """Take over a bus that was lost and is back at its present positions; the others hold their goals."""
    if loop.hardware.energised_joints.all():
        return
    while loop.executor.reference is not None and loop.executor.reference.velocity.any():
        yield  # the joints that are held brake
    back_with = ~loop.hardware.energised_joints & loop.hardware.open & beyond_hard_limit(loop)
    if some(back_with):
        why = f"to hold {joint_names(loop, back_with)} inside the hard limits would be a step"
        loop.say.event(
            "error", ReasonCode.OUT_OF_LIMIT, f"not taken over, torque goes off where it stands: {why}"
        )
        return
    here, located = _where_it_is(loop)
    back = loop.hardware.prepare_back(here, located)
    try:
        yield from all_of(back)
    except NoReply as error:
        message = f"lowered although a device did not answer: {error_text(loop, error)}"
        loop.say.event("error", ReasonCode.DEVICE_MISSING, message)
    except BusError as error:  # never a reason to drop the joints that are held
        message = f"not taken over, torque goes off where it stands: {error_text(loop, error)}"
        loop.say.event("error", ReasonCode.BUS_ERRORS, message)
        return
    if back and loop.written is not None:
        place = np.where(loop.hardware.energised_joints, loop.written, here)
        loop.hardware.hold(True, identified=True)
        loop.executor.begin(place)
        loop.written = place


def _where_it_is(loop: Loop) -> tuple[Floats, Bools]:
    """Return where to hold from (n,), as measured, as near as a goal may be; and which places are known.

    The rest pose stands for joints that never answered, or whose turn is unknown: it is not sent to them.
    """
    position = loop.measured.position
    finite = np.isfinite(position)
    return loop.hardware.reachable(np.where(finite, position, loop.rest)), finite


def _settled(loop: Loop, profile: SettleProfile) -> Generator[None, float, bool]:
    """Lower the robot and return True when it rests where torque may go off.

    False: the motion is refused, interrupted or too long, or only damping is allowed any more.
    """
    until = loop.clock.now() + profile.within
    free = loop.support not in ("fixed", "gantry")
    for _ in range(WAYS):
        reference = loop.executor.reference
        now = loop.clock.now()
        if reference is None or loop.torque.soft_since is not None or now >= until:
            break
        way = settle(reference, loop.rest, loop.limits, profile.way, profile.speed)
        refused = loop.executor.submit("settle", way)
        if refused is not None:
            loop.say.event("error", refused.code, f"no way to the rest pose: {refused.message}", (refused,))
            return False
        lasts = float(way.time[-1])
        if lasts > profile.within:
            loop.say.event("warning", EventCode.SETTLE, f"the way to the rest pose takes {lasts:.1f} s")
            # a service manager that waits for the end of the daemon
            loop.parts.notifier.extend(lasts + LETTING_GO)
            until = until if free else now + lasts + LATE
        yield from _wait_for_settle(loop, until)
        reference = loop.executor.reference
        if reference is not None and (np.abs(reference.position - loop.rest) <= ARRIVED).all():
            return not free or (yield from _rests(loop, until))
    if loop.torque.soft_since is None:
        loop.say.event("error", EventCode.SETTLE, "the way to the rest pose came to no end")
    return False


def _wait_for_settle(loop: Loop, until: float) -> Procedure:
    """Wait for the end of the motion, or for its interruption."""
    if not loop.torque.stop_begun and (yield from _check_goals_taken(loop)):
        loop.torque.confirm_stop_begun()
    now = yield
    while loop.executor.motion is Motion.ACTIVE and now < until and loop.torque.soft_since is None:
        now = yield


def _check_goals_taken(loop: Loop) -> Generator[None, float, bool]:
    """Check that the servos hold the goals of the last ticks: the motion has begun on the devices."""
    yield from ticks(2)
    try:
        held = yield from loop.hardware.read_goals()
    except BusError as error:
        message = f"the goals of the way could not be read back: {error_text(loop, error)}"
        loop.say.event("error", ReasonCode.BUS_ERRORS, message)
        return False
    if loop.written is None:
        return False
    lag = OBEYED * loop.limits.velocity * loop.period + loop.hardware.resolution
    held_joints = loop.hardware.energised_joints
    return bool((np.abs(held - loop.written)[held_joints] <= lag[held_joints]).all())


def _rests(loop: Loop, until: float) -> Generator[None, float, bool]:
    """Wait until every joint answers, is near its rest pose, and is slow for a while.

    False if not by `until` (s).
    """
    now = quiet_since = loop.clock.now()
    while now < until and loop.torque.soft_since is None:
        state = loop.measured
        near = (state.age <= SLOW_FOR) & (np.abs(state.position - loop.rest) <= NEAR)
        if not (near & (np.abs(state.velocity) <= SLOW)).all():
            quiet_since = now
        if now - quiet_since >= SLOW_FOR:
            return True
        now = yield
    loop.say.event("error", EventCode.SETTLE, "not at rest in the rest pose")
    return False
