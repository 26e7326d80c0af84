"""The fail-safe, `twind --failsafe`: lowers a robot whose daemon was given up, then switches torque off.

It runs the daemon's context, gate and procedures without clients: no control sockets, no front, no lease. No
operator is present: where an operator's `disarm` might drop the robot, this leaves it alone.

- It waits `WAIT` s for ports, devices and their torque, and no longer: a device that is connected an hour
 later must not move by itself. `stop` ends the wait, and no way down.
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

from twind import link
from twind.flight import EntryKind
from twind.loop.bus.bus_port import PortState as Stage
from twind.loop.ipc.front_link import ReceivedCommand, Record
from twind.loop.procedures.identification import IdentificationState
from twind.loop.procedures.lowering import LETTING_GO, SettleProfile
from twind.loop.procedures.procedure_context import ProcedureContext
from twind.loop.procedures.procedure_runner import Priority, Procedure, Steps
from twind.loop.procedures.torque_readback import found_limp, torque_known, torque_off, torque_on
from twind.loop.procedures.torque_release import TorqueRelease
from twind.loop.procedures.torque_switching import beyond_hard_limit, joint_names
from twind.loop.process.service_notify import Notifier
from twind.robot.arrays import Bools, every, some
from twind.robot.event_codes import EventCode
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode
from twind.safety.state_machine import RobotEvent
from twind.standard_streams import write_line
from twind_drivers.bus import BusError

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
ENDED = "it was ended before it had found out"


class FailsafeRun:
    """One run: the robot is lowered and released, or left as it is.

    `left` is the reason why torque may be on. It is "" only after torque was read back off everywhere, at the
    very end.
    """

    def __init__(
        self,
        context: ProcedureContext,
        identity: IdentificationState,
        release: TorqueRelease,
        notifier: Notifier,
    ) -> None:
        self.left = ENDED
        self._context = context
        self._identity = identity
        self._release = release
        self._notifier = notifier
        self._stopped = False

    def begin(self) -> None:
        """Begin with the next tick; the loop is finished at the end of the run, within `LONGEST` s.

        A path that the limits make longer than `WITHIN` extends the service manager's timeout by itself.
        """
        self._notifier.extend(LONGEST)  # what was needed to get here does not count
        self._context.procedures.beside(self._run())

    def stop(self) -> None:
        """End the run where it waits; a way down that has begun is completed."""
        self._stopped = True

    def _run(self) -> Procedure:
        try:
            yield from self._lower_or_leave()
        finally:  # also after an exception: without this procedure nothing would end the loop
            self._context.condition.finished = True
        return None

    def _lower_or_leave(self) -> Steps:
        context = self._context
        again = context.clock.now() + AGAIN
        why = ENDED
        for _ in range(TRIES):
            yield from self._wait_for_devices(context.clock.now() + WAIT)
            yield from self._wait_for_owner()  # torque off that is sent again
            if self._stopped:
                break
            # A robot that stands freely is not taken over again once its torque was ordered off.
            over = context.torque.inhibited or (context.torque.unconfirmed and not context.robot.carried)
            why = "" if over else why_left(context, self._identity)
            if why or over or torque_off(context) or context.clock.now() > again:
                break
            self._refused = ""
            context.procedures.own(Priority.SHUTDOWN, self._lower)
            yield from self._wait_for_owner()
            why = self._refused
            if context.torque.inhibited or not (torque_on(context) or some(~context.hardware.open)):
                break  # nothing is left that could be lowered
        self.left = "" if torque_off(context) else why or _afterwards(context)
        if self.left:
            context.reports.event("error", EventCode.FAILSAFE, self.left)
        else:
            context.reports.event("info", EventCode.FAILSAFE, "torque was read back off everywhere")

    def _wait_for_devices(self, until: float) -> Steps:
        """Wait until every device and torque is known, or torque is off, or time is over, or `stop`."""
        context = self._context
        now = yield
        while now < until and not torque_off(context) and not self._stopped:
            fresh = every(context.hardware.slow.torque >= 0) and every(context.robot.measured.age <= FRESH)
            if context.hardware.connected and fresh and not some(self._identity.verified.unjudged):
                return
            now = yield

    def _wait_for_owner(self) -> Steps:
        """Wait until no procedure owns the torque."""
        while self._context.procedures.rank is not None:
            yield

    def _lower(self) -> Procedure:
        context = self._context
        whole = not context.robot.carried
        manner = SettleProfile(speed=SPEED, way=WAY, within=WITHIN, whole=whole)
        context.reports.event(
            "warning",
            EventCode.FAILSAFE,
            f"the robot is lowered, then torque goes off (support: {context.robot.support})",
        )
        context.condition.change_if(RobotEvent.SETTLE)
        try:
            why = Finding(ReasonCode.NOT_ARMED, message="the daemon was given up")
            yield from self._release.release(why, manner)
        except BusError as error:
            if not context.torque.unconfirmed:  # torque off was never requested
                self._refused = f"torque is on, not every device could be taken over: {error}"
        context.condition.change_if(RobotEvent.SETTLED)
        return None


def why_left(context: ProcedureContext, identity: IdentificationState) -> str:
    """Return the reason why this robot is not lowered, with the remedy.

    "": it may be, or its torque is off.
    """
    if torque_off(context):
        return ""
    closed = [port for port in context.hardware.ports if port.reader is None]
    on = torque_known(context) == 1
    if not some(on):
        why = closed[0].trouble or f"{closed[0].name} is not open" if closed else "no answer: power?"
        return (
            f"whether torque is on is not known of {joint_names(context, torque_known(context) < 0)}: {why}"
        )
    if context.condition.mode is not Mode.LIVE:
        return f"torque is on, and mode {context.condition.mode.value} of the settings writes nothing"
    devices = {(port.name, each.id): each for port in context.hardware.ports for each in port.devices}
    doubts = (
        *context.robot.bound.judge(devices).refusals,
        *_not_identified(identity),
        *identity.verified.mismatches,
        *identity.verified.doubts(),
    )
    for doubt in doubts:
        if doubt.code is not ReasonCode.DEVICE_MISSING:
            return f"torque is on, and the joint positions are unknown: {doubt.code}: {doubt.message}"
    unjudged = _unjudged(context, identity)
    if some(unjudged):
        return f"torque is on, and of {joint_names(context, unjudged)} the positions are not known yet"
    limp = found_limp(context)
    beyond = beyond_hard_limit(context) & ~limp
    if some(beyond):
        return (
            f"torque is on, and to hold {joint_names(context, beyond)} inside the hard limits would be a step"
        )
    return "" if context.robot.carried else _not_whole(context, identity, on | limp)


def _unjudged(context: ProcedureContext, identity: IdentificationState) -> Bools:
    """Return joints (n,) that may have torque, and whose positions are about to be known.

    Their devices answer, or their bus is being identified. Not those of devices that it has missed.
    """
    soon: Bools = context.robot.measured.age <= FRESH
    for port in context.hardware.ports:
        if port.link is Stage.IDENTIFYING:
            soon |= context.robot.joints.on_bus(port.name)
    soon[[each.joint for each in _not_identified(identity) if each.joint is not None]] = False
    soon &= identity.verified.unjudged & context.hardware.open & (torque_known(context) != 0)
    return soon


def _not_identified(identity: IdentificationState) -> list[Finding]:
    """Return the findings of the last identification of each open bus."""
    return [each for findings in identity.missing.values() for each in findings]


def _not_whole(context: ProcedureContext, identity: IdentificationState, well: Bools) -> str:
    """Return the reason why a robot that stands freely cannot be taken over completely; "": it can.

    `well` (n,): joints with torque, or that may be limp.
    """
    state = context.robot.measured
    stands = f"torque is on, support is {context.robot.support!r}, and"
    if not context.hardware.connected or not every(state.age <= FRESH):
        missing = [each.message for each in _not_identified(identity)]
        missing += [port.trouble for port in context.hardware.ports if port.link is Stage.CLOSED]
        cause = (
            missing[0]
            if missing
            else f"{joint_names(context, ~(state.age <= FRESH))} without a fresh reading"
        )
        return f"{stands} not every device is there: {cause}"
    if not every(well):
        return f"{stands} it is not on in {joint_names(context, ~well)}"
    return ""


def _afterwards(context: ProcedureContext) -> str:
    """Return a text that names the joints without confirmed torque off, and the latched reason."""
    why = next((f"{each.code}: {each.message}" for each in context.condition.latches.values()), "no answer")
    names = joint_names(context, context.hardware.slow.torque != 0)
    return f"torque could not be read back off from {names}: {why}"


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
