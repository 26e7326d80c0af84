"""Letting go: disarm, fault, shutdown, e-stop. Each goes the way to the rest pose where the robot can be
held, then takes the torque off, twice, and reads it back. Only an explicit cut skips the way. A way that
comes to no end is damped (`damping`) before torque goes off.

What a procedure says of torque it has read back. What could not be read back is said to be so.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from twind import link
from twind.loop import damping
from twind.loop.procedures import Priority, Procedure, all_of, ticks
from twind.loop.torque import (
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
    from twind.loop.tick import Loop
    from twind.robot.arrays import Bools, Floats

SETTLE = 4.0  # s from the first packet to torque off (W6); a robot that stands freely is damped then
WAY = 3.2  # s for the way to the rest pose, more where the limits need it (docs/reason-codes.md)
LATE = 1.0  # s beyond a planned way that takes longer than that, before it is given up
WAYS = 2  # ways that are tried: a fault on the first one ends it where it stands
OBEYED = 6  # ticks that a goal read back may be behind the one being written
LETTING_GO = 10.0  # s from the end of a way to the end of damping and to torque read back off
AWAITED = 1.5  # s that an ending daemon waits for a bus that went away with torque of ours
ARRIVED = 0.02  # rad from the rest pose, of the goals
NEAR = 0.1  # rad from the rest pose, as measured: a free-standing robot is let go only there ...
# rad/s ... and when it has been at rest for so many s
SLOW = 0.05
SLOW_FOR = 0.5
# s that the turn of a joint is waited for that was heard so lately
KNOWN = 0.5
HEARD = 0.1
RANKS = {"settle": Priority.ESTOP, "cut": Priority.CUT}


@dataclass(frozen=True, slots=True)
class SettleProfile:
    """Settings of how a robot is lowered."""

    speed: float = SPEED  # share of every limit on the way, when there is time for it
    way: float = WAY  # s for the way, more where the limits need it
    within: float = SETTLE  # s from the take-over to torque off; a robot that stands freely is damped then
    whole: bool = False  # who cannot be taken over whole keeps its torque, instead of losing it where it is


USUAL = SettleProfile()


def disarm(loop: Loop, command: link.Disarm, now: float) -> Procedure:
    """SETTLE, then torque off. Answers when torque is read back off."""
    if not loop.energised:
        _say_disarmed(loop, command)
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
        _say_disarmed(loop, command)
        return
    loop.change_if(RobotEvent.SETTLED, loop.clock.now())  # `inherited` and `torque` tell who is still on


def _say_disarmed(loop: Loop, command: link.Disarm) -> None:
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
    """SIGTERM: lower the robot if its torque is ours, then end. What was found energised, or may not be
    written to any more, is left as it is; torque of ours that went with a bus is waited for."""
    until = now + AWAITED
    while loop.owed and not loop.hardware.connected and now < until:
        now = yield
    if (loop.armed or loop.energising or (loop.owed and loop.torque_on)) and not loop.inhibited:
        loop.change_if(RobotEvent.SETTLE, now)
        yield from _down(loop, Finding(ReasonCode.NOT_ARMED, message="the daemon ends: the robot is lowered"))
        loop.change_if(RobotEvent.SETTLED, loop.clock.now())
    until = loop.clock.now() + AWAITED
    while loop.homing.owed is not None and loop.clock.now() < until:
        yield  # what was driven against its stop is given back
    loop.homing.report_pending_restore()
    loop.finished = True


def stop(loop: Loop, level: str, now: float) -> None:
    """Begin an e-stop, unless one as hard is under way. While it is latched it is begun again for every bus
    that comes back with torque on."""
    loop.stop_level = "cut" if "cut" in (level, loop.stop_level) else level
    rank = RANKS[level]
    if loop.procedures.rank is None or loop.procedures.rank < rank:
        loop.stops.begin()
        loop.procedures.own(rank, lambda: estop(loop, level, now))


def estop(loop: Loop, level: str, now: float) -> Procedure:
    """Stop, by level. `Loop.stops` answers those who asked: when it has begun, and when it is over."""
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


def release(loop: Loop, why: Finding, manner: SettleProfile = USUAL) -> Procedure:
    """Down to the rest pose if the robot can be held, then torque off and read back. Raises BusError.

    What was under way ends as aborted, for the reason `why`. What does not come to rest there is damped.
    With `manner.whole` torque stays on where not every device took the goals over; BusError says who.
    """
    loop.executor.stop("aborted", (why,))
    loop.hardware.clear()  # what this takes over may have begun to give servos their strength back
    try:
        held = not loop.inhibited and (yield from _held(loop, manner))
        if held and not (yield from _settled(loop, manner)):
            yield from damping.damp(loop)
    except BusError as error:
        if manner.whole and not loop.armed:
            raise
        said = f"the way to the rest pose was cut short: {error_text(loop, error)}"
        loop.say.event("error", ReasonCode.BUS_ERRORS, said)
    yield from switch_torque_off(loop)


def _held(loop: Loop, manner: SettleProfile) -> Generator[None, float, bool]:
    """We hold the robot, or took over what was found on or tripped. False: it is limp, or was just about to
    be energised: then there is nothing to lower."""
    held = loop.hardware.energised_joints
    tripped = loop.hardware.slow.watchdog == 255
    if loop.armed and loop.soft_since is not None:
        return True  # it sinks: to clear tripped watchdogs would give it its strength back
    if loop.armed and held.any() and not (held & tripped).any():
        yield from _rejoined(loop)
        return True
    if loop.energising or not loop.torque_on:
        return False
    yield from _looked_for(loop)
    (here, known), stepped = _where_it_is(loop), beyond_hard_limit(loop)
    if loop.armed and loop.written is not None:  # who holds well goes on so: its goal would dip by its sag
        well = held & ~tripped
        here = np.where(well, loop.written, here)
        known = known | well
        stepped = stepped & ~well
    if some(stepped):
        _leave(loop, stepped, manner)
        return False
    if not every(known):
        _leave_out(loop, ~known, manner)
        if not some(known):
            return False
    loop.executor.idle()
    loop.hardware.clear()
    try:
        yield from all_of(loop.hardware.prepare(here, known))  # clears watchdogs with goal := present
    except NoReply as error:  # the others took it: to lower what listens is better than to drop it
        if manner.whole:
            raise
        said = f"lowered without everybody's answer: {error_text(loop, error)}"
        loop.say.event("error", ReasonCode.DEVICE_MISSING, said)
    take(loop, here)
    return True


def _leave(loop: Loop, stepped: Bools, manner: SettleProfile) -> None:
    """Report that joints (n,) past their hard limits are not taken over: to hold them would be a step.

    Raises BusError where the whole robot is wanted and it is not armed.
    """
    message = f"to hold {joint_names(loop, stepped)} inside the hard limits would be a step"
    if manner.whole and not loop.armed:
        raise BusError(message)
    joint = int(np.flatnonzero(stepped)[0])
    found = Finding(
        ReasonCode.OUT_OF_LIMIT, joint, value=float(loop.measured.position[joint]), message=message
    )
    said = f"{message}: torque goes off where the robot stands; support it"
    loop.say.event("error", ReasonCode.OUT_OF_LIMIT, said, (found,))


def _leave_out(loop: Loop, nowhere: Bools, manner: SettleProfile) -> None:
    """Report that joints (n,) of unknown place get no goal: it could be a turn away.

    Raises BusError where the whole robot is wanted and it is not armed.
    """
    message = f"nobody knows where {joint_names(loop, nowhere)} is"
    if manner.whole and not loop.armed:
        raise BusError(message)
    joint = int(np.flatnonzero(nowhere)[0])
    found = Finding(ReasonCode.CALIB_MISMATCH, joint, message=message)
    said = f"{message}: no goal goes there, it is let go where it stands; support it"
    loop.say.event("error", ReasonCode.CALIB_MISMATCH, said, (found,))


def _looked_for(loop: Loop) -> Procedure:
    """Wait at most `KNOWN` s for the turn check of joints that answered within the last `HEARD` s.

    Such joints are still unchecked when the daemon has just begun.
    """
    until = loop.clock.now() + KNOWN
    while some(loop.identity.verified.unjudged & (loop.measured.age <= HEARD)) and loop.clock.now() < until:
        yield


def _rejoined(loop: Loop) -> Procedure:
    """A bus that was lost and is back is taken over where its joints are; the others hold what they held."""
    if loop.hardware.energised_joints.all():
        return
    while loop.executor.reference is not None and loop.executor.reference.velocity.any():
        yield  # those that we hold brake
    back_with = ~loop.hardware.energised_joints & loop.hardware.open & beyond_hard_limit(loop)
    if some(back_with):
        why = f"to hold {joint_names(loop, back_with)} inside the hard limits would be a step"
        loop.say.event("error", ReasonCode.OUT_OF_LIMIT, f"not taken over, let go where it stands: {why}")
        return
    here, known = _where_it_is(loop)
    back = loop.hardware.prepare_back(here, known)
    try:
        yield from all_of(back)
    except NoReply as error:
        said = f"lowered without everybody's answer: {error_text(loop, error)}"
        loop.say.event("error", ReasonCode.DEVICE_MISSING, said)
    except BusError as error:  # never a reason to drop those that we hold
        said = f"not taken over, let go where it stands: {error_text(loop, error)}"
        loop.say.event("error", ReasonCode.BUS_ERRORS, said)
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
    known = np.isfinite(position)
    return loop.hardware.reachable(np.where(known, position, loop.rest)), known


def _settled(loop: Loop, manner: SettleProfile) -> Generator[None, float, bool]:
    """The robot rests where it may be let go. False: the way there is refused, interrupted or too long, or
    nothing but damping is wanted any more."""
    until = loop.clock.now() + manner.within
    free = loop.support not in ("fixed", "gantry")
    for _ in range(WAYS):
        reference = loop.executor.reference
        now = loop.clock.now()
        if reference is None or loop.soft_since is not None or now >= until:
            break
        way = settle(reference, loop.rest, loop.limits, manner.way, manner.speed)
        refused = loop.executor.submit("settle", way)
        if refused is not None:
            loop.say.event("error", refused.code, f"no way to the rest pose: {refused.message}", (refused,))
            return False
        lasts = float(way.time[-1])
        if lasts > manner.within:
            loop.say.event("warning", EventCode.SETTLE, f"the way to the rest pose takes {lasts:.1f} s")
            loop.parts.notifier.extend(lasts + LETTING_GO)  # a service manager that waits for our end
            until = until if free else now + lasts + LATE
        yield from _wait_for_settle(loop, until)
        reference = loop.executor.reference
        if reference is not None and (np.abs(reference.position - loop.rest) <= ARRIVED).all():
            return not free or (yield from _rests(loop, until))
    if loop.soft_since is None:
        loop.say.event("error", EventCode.SETTLE, "the way to the rest pose came to no end")
    return False


def _wait_for_settle(loop: Loop, until: float) -> Procedure:
    """Wait for the end of the way, or for what ends it."""
    loop.stops.begun = loop.stops.begun or (yield from _obeyed(loop))
    now = yield
    while loop.executor.motion is Motion.ACTIVE and now < until and loop.soft_since is None:
        now = yield


def _obeyed(loop: Loop) -> Generator[None, float, bool]:
    """The servos hold the goals that the last ticks wrote: the way has begun where it counts."""
    yield from ticks(2)
    try:
        held = yield from loop.hardware.read_goals()
    except BusError as error:
        said = f"the goals of the way could not be read back: {error_text(loop, error)}"
        loop.say.event("error", ReasonCode.BUS_ERRORS, said)
        return False
    if loop.written is None:
        return False
    lag = OBEYED * loop.limits.velocity * loop.period + loop.hardware.resolution
    ours = loop.hardware.energised_joints
    return bool((np.abs(held - loop.written)[ours] <= lag[ours]).all())


def _rests(loop: Loop, until: float) -> Generator[None, float, bool]:
    """Wait until every joint answers, is near its rest pose, and is slow for a while; False if not by `until`
    (s)."""
    now = quiet_since = loop.clock.now()
    while now < until and loop.soft_since is None:
        state = loop.measured
        near = (state.age <= SLOW_FOR) & (np.abs(state.position - loop.rest) <= NEAR)
        if not (near & (np.abs(state.velocity) <= SLOW)).all():
            quiet_since = now
        if now - quiet_since >= SLOW_FOR:
            return True
        now = yield
    loop.say.event("error", EventCode.SETTLE, "not at rest in the rest pose")
    return False
