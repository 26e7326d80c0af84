"""The fail-safe, `twind --failsafe`: lowers a robot whose daemon was given up, then switches torque off.

It runs the daemon's loop, gate and procedures without clients: no control sockets, no front, no lease. No
operator is present: where an operator's `disarm` might drop the robot, this leaves it alone.

- It waits `WAIT` s for ports, devices and their torque, and no longer: a device that is connected an hour
 later must not move by itself.
- Torque off everywhere: nothing is written. Modes mirror and sim write nothing either.
- Devices that differ from the files are left as they are: the positions of their joints are unknown. Joints
 beyond their hard limits are left too: a goal inside them would be a step.
- `support: fixed | gantry`: lowered and released as by `disarm`, without devices that are missing or refuse.
- `support: free` or any other value: taken over completely, or left as it is.
 After the take-over the stop ladder holds: torque off at rest in the rest pose, else damped first.
- The motion takes a quarter of every limit instead of half: no client waits for it, and a person may be in
 its way.
- A robot that is left stands where its servos' watchdogs stopped it, with torque on, until an operator comes.
"""

from __future__ import annotations

import contextlib
import os
from typing import TYPE_CHECKING

from twind import link
from twind.flight import EntryKind
from twind.loop.bus.bus_port import PortState as Stage
from twind.loop.ipc.front_link import ReceivedCommand, Record
from twind.loop.procedures.procedure_runner import Priority, Procedure
from twind.loop.procedures.torque_release import LETTING_GO, SettleProfile, release
from twind.loop.procedures.torque_switching import beyond_hard_limit, joint_names
from twind.robot.arrays import Bools, every, some
from twind.robot.event_codes import EventCode
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode
from twind.safety.state_machine import RobotEvent
from twind.standard_streams import write_line
from twind_drivers.bus import BusError

if TYPE_CHECKING:
    from collections.abc import Generator

    from twind.loop.tick.control_loop import Loop

WAIT = 10.0  # s for ports, devices and their torque, before the robot is judged
# attempts, and s in which they begin: a bus may come back, a reply may have been lost
TRIES = 3
AGAIN = 20.0
FRESH = 0.1  # s, the oldest reading of a joint for a take-over; an older one could make the goal a step
# share of the limits; s for the path; s after which the robot is damped
SPEED = 0.25
WAY = 15.0
WITHIN = 30.0
LONGEST = (
    AGAIN + WITHIN + LETTING_GO + WAIT
)  # s: the last way that is begun, what is known of torque after it
CARRIED = ("fixed", "gantry")  # support values under which the robot falls no further than its own arms


class FailsafeRun:
    """One run: the robot is lowered and released, or left as it is.

    `left` is the reason why torque may be on. It is "" only after torque was read back off everywhere, at the
    very end.
    """

    def __init__(self, loop: Loop) -> None:
        self.left = "it was ended before it had found out"
        self._loop = loop
        self._refused = ""

    def begin(self) -> None:
        """Begin with the next tick; the loop is finished at the end of the run, within `LONGEST` s.

        A path that the limits make longer than `WITHIN` extends the service manager's timeout by itself.
        """
        self._loop.parts.notifier.extend(LONGEST)  # what was needed to get here does not count
        self._loop.procedures.beside(self._run())

    def _run(self) -> Procedure:
        loop = self._loop
        again = loop.clock.now() + AGAIN
        for _ in range(TRIES):
            yield from self._wait_for_devices(loop.clock.now() + WAIT)
            why = why_left(loop)
            if why or loop.torque_off or loop.clock.now() > again:
                break
            self._refused = ""
            loop.procedures.own(Priority.SHUTDOWN, lambda: self._lower(loop))
            while loop.procedures.rank is not None:
                yield
            why = self._refused
            if loop.torque.inhibited or not (loop.torque_on or some(~loop.hardware.open)):
                break  # nothing is left that could be lowered
        self.left = "" if loop.torque_off else why or _afterwards(loop)
        if self.left:
            loop.say.event("error", EventCode.FAILSAFE, self.left)
        else:
            loop.say.event("info", EventCode.FAILSAFE, "torque was read back off everywhere")
        loop.finished = True

    def _wait_for_devices(self, until: float) -> Generator[None, float, None]:
        """Wait until every device and torque is known, or torque is off, or time is over."""
        loop = self._loop
        now = yield
        while now < until and not loop.torque_off:
            fresh = every(loop.hardware.slow.torque >= 0) and every(loop.measured.age <= FRESH)
            if loop.hardware.connected and fresh and not some(loop.identity.verified.unjudged):
                return
            now = yield

    def _lower(self, loop: Loop) -> Procedure:
        whole = loop.support not in CARRIED
        manner = SettleProfile(speed=SPEED, way=WAY, within=WITHIN, whole=whole)
        loop.say.event(
            "warning",
            EventCode.FAILSAFE,
            f"the robot is lowered, then torque goes off (support: {loop.support})",
        )
        loop.change_if(RobotEvent.SETTLE, loop.clock.now())
        try:
            yield from release(loop, Finding(ReasonCode.NOT_ARMED, message="the daemon was given up"), manner)
        except BusError as error:
            if not loop.torque.unconfirmed:  # torque off was never requested
                self._refused = f"torque is on, not every device could be taken over: {error}"
        loop.change_if(RobotEvent.SETTLED, loop.clock.now())


def why_left(loop: Loop) -> str:
    """Return the reason why this robot is not lowered, with the remedy.

    "": it may be, or its torque is off.
    """
    if loop.torque_off:
        return ""
    closed = [port for port in loop.hardware.ports if port.reader is None]
    on = loop.torque_known == 1
    if not some(on):
        why = closed[0].trouble or f"{closed[0].name} is not open" if closed else "no answer: power?"
        return f"whether torque is on is not known of {joint_names(loop, loop.torque_known < 0)}: {why}"
    if loop.mode is not Mode.LIVE:
        return f"torque is on, and mode {loop.mode.value} of the settings writes nothing"
    devices = {(port.name, each.id): each for port in loop.hardware.ports for each in port.devices}
    identity = loop.identity
    doubts = (*loop.parts.judge(devices).refusals, *identity.mismatches, *identity.verified.doubts())
    for doubt in doubts:
        if doubt.code is not ReasonCode.DEVICE_MISSING:
            return f"torque is on, and the joint positions are unknown: {doubt.code}: {doubt.message}"
    beyond = beyond_hard_limit(loop)
    if some(beyond):
        return f"torque is on, and to hold {joint_names(loop, beyond)} inside the hard limits would be a step"
    return "" if loop.support in CARRIED else _not_whole(loop, on)


def _not_whole(loop: Loop, on: Bools) -> str:
    """Return the reason why a robot that stands freely cannot be taken over completely; "": it can."""
    state = loop.measured
    stands = f"torque is on, support is {loop.support!r}, and"
    if not loop.hardware.connected or not every(state.age <= FRESH):
        missing = [each.message for found in loop.identity.missing.values() for each in found]
        missing += [port.trouble for port in loop.hardware.ports if port.link is Stage.CLOSED]
        cause = (
            missing[0] if missing else f"{joint_names(loop, ~(state.age <= FRESH))} without a fresh reading"
        )
        return f"{stands} not every device is there: {cause}"
    if not every(on):
        return f"{stands} it is not on in {joint_names(loop, ~on)}"
    return ""


def _afterwards(loop: Loop) -> str:
    """Return a text that names the joints without confirmed torque off, and the latched reason."""
    why = next((f"{each.code}: {each.message}" for each in loop.latches.values()), "no answer")
    return (
        f"torque could not be read back off from {joint_names(loop, loop.hardware.slow.torque != 0)}: {why}"
    )


class HeadlessLink:
    """`ControlLink` without a front: no commands; events are lines on a descriptor, or lost."""

    def __init__(self, fd: int, record: Record | None = None) -> None:
        """`record`: the recorder that receives the messages; None: none."""
        self.dropped = 0
        self.lost = False
        self.no_front = ""
        self._fd = fd
        self._numbers = 0
        self._record = record

    def supervise_front(self, now: float) -> None:
        """Do nothing: there is no front."""

    def set_briefing(self, briefing: int) -> None:
        """Close the briefing: there is no front to receive it."""
        os.close(briefing)

    def ask_reread(self) -> None:
        """Do nothing: no front reads the files."""

    def commands(self, now: float) -> list[ReceivedCommand]:
        """Return no commands: there are no clients."""
        return []

    def reply(self, reply: link.Reply) -> None:
        """Do nothing: there are no calls to answer."""

    def event(self, event: link.Event | link.VerdictReport) -> None:
        """Write an event as a line, without a retry; then pass it to the recorder."""
        if isinstance(event, link.Event):
            write_line(self._fd, event.level, f"{event.level} {event.code}: {event.message}")
        self._write_down(event)

    def sequence(self) -> int:
        """Return a number for the next event."""
        self._numbers += 1
        return self._numbers

    def state(self, news: link.Tick | link.Overview) -> None:
        """Pass the state to the recorder only: no client reads it."""
        self._write_down(news)

    def flush(self) -> None:
        """Do nothing: no message waits."""

    def close(self) -> None:
        """Do nothing: there is nothing to end."""

    def _write_down(self, news: link.Outward) -> None:
        if self._record is None:
            return
        with contextlib.suppress(TypeError, ValueError, OverflowError):  # not encodable: no reason to stop
            self._record(EntryKind.NEWS, link.encode(news))
