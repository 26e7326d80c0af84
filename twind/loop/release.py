"""Letting go: disarm, fault, shutdown, e-stop. Each goes the way to the rest pose where the robot can be
held, then takes the torque off, twice, and reads it back. Only an explicit cut skips the way.

What a procedure says of torque it has read back. What could not be read back is said to be so.
"""

from __future__ import annotations

from collections.abc import Generator
from math import inf
from typing import TYPE_CHECKING

import numpy as np

from twind import link
from twind.loop.arming import take
from twind.loop.procedures import Procedure, Rank, all_of, ticks
from twind.motion.settle import settle
from twind.robot.finding import Code, Finding
from twind.robot.modes import Mode, Motion
from twind.safety.states import Event
from twind_drivers.bus import BusError, NoReply

if TYPE_CHECKING:
    from twind.loop.tick import Loop
    from twind.robot.arrays import Floats

SETTLE = 4.0  # s for the way to the rest pose (docs/safety.md)
LATE = 1.0  # s beyond the planned way before it is given up
WAYS = 2  # ways that are tried: a fault on the first one ends it where it stands
OBEYED = 6  # ticks that a goal read back may be behind the one being written
INSIST = 1.0  # s that torque off is repeated to those who do not confirm it
AWAITED = 1.5  # s that an ending daemon waits for a bus that went away with torque of ours
ARRIVED = 0.02  # rad from the rest pose
SLOW = 0.05  # rad/s: a free-standing robot is let go only when it has come to rest ...
SLOW_FOR, SLOW_MOST = 1.0, 5.0  # s ... for this long, or after this long at the latest
RANKS = {"settle": Rank.ESTOP, "cut": Rank.CUT}


def disarm(loop: Loop, command: link.Disarm, now: float) -> Procedure:
    """SETTLE, then torque off. Answers when torque is read back off."""
    if not loop.energised:
        _say_disarmed(loop, command)
        return
    loop.change_if(Event.SETTLE, now)
    try:
        yield from release(loop, Finding(Code.NOT_ARMED, message="the robot was disarmed"))
    except BusError as error:
        loop.say.error(command, "BusFailed", bus="", message=str(error))
    except GeneratorExit:
        loop.say.error(command, "Busy", what="disarming was ended by something more urgent")
        raise
    else:
        loop.change_if(Event.SETTLED, loop.clock.now())
        _say_disarmed(loop, command)
        return
    loop.change_if(Event.SETTLED, loop.clock.now())  # `inherited` and `torque` tell who is still on


def _say_disarmed(loop: Loop, command: link.Disarm) -> None:
    """Done, unless there is a bus that nobody could ask."""
    closed = [port for port in loop.hardware.ports if port.reader is None]
    if loop.mode is Mode.LIVE and closed:
        message = f"{closed[0].trouble or 'the bus is not open'}; whether torque is on there is not known"
        loop.say.error(command, "BusFailed", bus=closed[0].name, message=message)
    else:
        loop.say.reply(command, state=loop.state.value)


def fault(loop: Loop, now: float) -> Procedure:
    """After a fault that cannot be held: settle and let go. The state stays FAULT until a reset."""
    latched = next(iter(loop.latches.values()), Finding(Code.FAULT_LATCHED, message="a fault"))
    yield from _down(loop, latched)


def _down(loop: Loop, why: Finding) -> Procedure:
    try:
        yield from release(loop, why)
    except BusError as error:
        loop.say.event("error", Code.TORQUE_MISMATCH, f"torque could not be read back off: {error}")


def shutdown(loop: Loop, now: float) -> Procedure:
    """SIGTERM: lower the robot if its torque is ours, then end. What was found energised, or may not be
    written to any more, is left as it is; torque of ours that went with a bus is waited for."""
    until = now + AWAITED
    while loop.owed and not loop.hardware.connected and now < until:
        now = yield
    if (loop.armed or loop.energising or (loop.owed and loop.torque_on)) and not loop.inhibited:
        loop.change_if(Event.SETTLE, now)
        yield from _down(loop, Finding(Code.NOT_ARMED, message="the daemon ends: the robot is lowered"))
        loop.change_if(Event.SETTLED, loop.clock.now())
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
    loop.change(Event.ESTOP, now)
    loop.executor.stop("aborted", (loop.latches[Code.ESTOP],))
    if loop.mode is not Mode.LIVE or not loop.hardware.writers:
        loop.twin.halt()
        return
    try:
        if level == "cut":
            yield from loosen(loop)
        else:
            yield from release(loop, loop.latches[Code.ESTOP])
    except BusError as error:
        loop.say.event("error", Code.TORQUE_MISMATCH, f"torque could not be read back off: {error}")


# ----------------------------------------------------------------------------------------------- the parts


def release(loop: Loop, why: Finding) -> Procedure:
    """Down to the rest pose if the robot can be held, then torque off and read back. Raises BusError.

    What was under way ends as aborted, for the reason `why`.
    """
    loop.executor.stop("aborted", (why,))
    try:
        if not loop.inhibited and (yield from _held(loop)):
            yield from _settle(loop)
    except BusError as error:
        loop.say.event("error", Code.BUS_ERRORS, f"the way to the rest pose was cut short: {error}")
    yield from loosen(loop)


def _held(loop: Loop) -> Generator[None, float, bool]:
    """We hold the robot, or took over what was found on or tripped. False: it is limp, or was just about to
    be energised: then there is nothing to lower."""
    tripped = bool((loop.hardware.slow.watchdog == 255).any())
    if loop.armed and not tripped:
        return True
    if loop.energising or not loop.torque_on:
        return False
    here = _where_it_is(loop)
    loop.executor.idle()
    loop.hardware.clear()
    try:
        yield from all_of(loop.hardware.prepare(here))  # clears watchdogs with goal := present
    except NoReply as error:  # the others took it: to lower what listens is better than to drop it
        loop.say.event("error", Code.DEVICE_MISSING, f"lowered without everybody's answer: {error}")
    take(loop, here)
    return True


def _where_it_is(loop: Loop) -> Floats:
    """Where (n,) to hold from: as measured, within the hard limits; the rest pose of who never answered."""
    measured, limits = loop.measured, loop.limits
    known = np.where(np.isfinite(measured.position), measured.position, loop.rest)
    return np.clip(known, limits.hard_lower, limits.hard_upper)


def _settle(loop: Loop) -> Procedure:
    for _ in range(WAYS):
        reference = loop.executor.reference
        if reference is None:
            return
        way = settle(reference, loop.rest, loop.limits, SETTLE)
        refused = loop.executor.submit("settle", way)
        if refused is not None:
            loop.say.event("error", refused.code, f"no way to the rest pose: {refused.message}", (refused,))
            return
        until = loop.clock.now() + float(way.time[-1]) + LATE
        loop.stops.begun = loop.stops.begun or (yield from _obeyed(loop))
        now = yield
        while loop.executor.motion is Motion.ACTIVE and now < until:
            now = yield
        reference = loop.executor.reference
        if reference is not None and (np.abs(reference.position - loop.rest) <= ARRIVED).all():
            break
    if loop.support == "free":
        yield from _come_to_rest(loop)


def _obeyed(loop: Loop) -> Generator[None, float, bool]:
    """The servos hold the goals that the last ticks wrote: the way has begun where it counts."""
    yield from ticks(2)
    try:
        held = yield from loop.hardware.aimed()
    except BusError as error:
        loop.say.event("error", Code.BUS_ERRORS, f"the goals of the way could not be read back: {error}")
        return False
    if loop.written is None:
        return False
    lag = OBEYED * loop.limits.velocity * loop.period + loop.hardware.resolution
    return bool((np.abs(held - loop.written)[loop.hardware.open] <= lag[loop.hardware.open]).all())


def _come_to_rest(loop: Loop) -> Procedure:
    now = loop.clock.now()
    quiet_since, until = now, now + SLOW_MOST
    while now < until and now - quiet_since < SLOW_FOR:
        now = yield
        if not (np.abs(loop.measured.velocity) <= SLOW).all():
            quiet_since = now


def loosen(loop: Loop) -> Procedure:
    """Torque off, read back. Raises BusError naming who did not confirm."""
    loop.executor.idle()
    loop.hardware.clear()
    loop.hardware.hold(False)
    for writer in loop.hardware.writers:
        writer.cut()  # twice, with the next packet of any kind
    loop.hardware.quiet_until = -inf  # torque off waits for nobody's watchdog
    loop.armed, loop.energising = False, True  # not known to be off until it is read back
    until = loop.clock.now() + INSIST
    while True:
        try:
            yield from all_of(loop.hardware.torque(False))
        except BusError:
            if loop.clock.now() < until and loop.hardware.writers:
                yield
                continue
            loop.energising = False  # who is still on stands in the registers, and is reported as inherited
            raise
        loop.energising = False
        return
