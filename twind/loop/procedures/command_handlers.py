"""Handler of each command of the front: a reply at once, or a procedure begun."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from twind import link
from twind.loop.ipc.front_link import ReceivedCommand
from twind.loop.procedures import arming, device_procedures, torque_release
from twind.loop.procedures.procedure_runner import Priority, Procedure
from twind.loop.procedures.submission_tracker import SubmissionTracker
from twind.robot.event_codes import EventCode
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode, Motion, RobotState
from twind.safety.state_machine import RobotEvent, mode_change

if TYPE_CHECKING:
    from twind.loop.tick.control_loop import Loop

__all__ = ["SubmissionTracker", "begin"]

LOWERING = "wait until torque is off, as `twindctl status --joints` shows"


def serve(loop: Loop, now: float) -> None:
    """Serve all commands and pending requests of this tick.

    An e-stop precedes all others: a command of the same tick must not start a motion that it should stop.
    """
    incoming = loop.link.commands(now)
    incoming.sort(key=lambda each: not isinstance(each.command, link.EStop))
    for each in incoming:
        try:
            begin(loop, each, now)
        except Exception as error:  # noqa: BLE001 - an error in one call must not affect the others
            loop.fail(Finding(ReasonCode.INTERNAL, message=repr(error)), now)
            if isinstance(each.command, link.Command):
                loop.say.error(each.command, "Busy", what=f"failed inside: {error!r}")
    if loop.link.lost:
        front_lost(loop)
    loop.calibrating.end_if_due(now)
    loop.reloads.serve(now)
    if loop.stop_wanted and loop.procedures.own(
        Priority.SHUTDOWN, lambda: torque_release.shutdown(loop, now)
    ):
        loop.say.event(
            "info",
            EventCode.STOPPING,
            "the daemon ends" + (": lowering the robot" if loop.torque.armed else ""),
        )


def begin(loop: Loop, incoming: ReceivedCommand, now: float) -> None:
    """Reply to a command, or start the procedure that will reply."""
    command = incoming.command
    if isinstance(command, link.Submit):
        loop.submissions.begin(command, incoming.data, now)
    elif isinstance(command, link.ApplyChanges):
        loop.reloads.adopt(command, incoming.fd, now)
    else:
        _HANDLERS[type(command)](loop, command, now)


def _gone(loop: Loop, command: link.ConnectionClosed, now: float) -> None:
    """Process a closed connection: its lease lapses, and an arming that it began ends with torque off."""
    loop.lease.release_client(command.client)
    loop.submissions.drop_client(command.client)
    loop.stops.drop_client(command.client)
    if loop.procedures.rank is Priority.ARM and loop.arming_client == command.client:
        loop.procedures.own(Priority.DISARM, lambda: arming.give_up(loop))


def front_lost(loop: Loop) -> None:
    """Process the loss of the front and of every connection: leases lapse, motion holds, torque stays."""
    loop.link.lost = False
    loop.lease.front_lost()
    loop.submissions.forget()
    _hold(loop, Finding(ReasonCode.LEASE_LOST, message="the front was lost"))
    loop.say.event("error", ReasonCode.LEASE_LOST, "the front was lost; a new one is started")
    loop.reloads.front_lost()


def _hold(loop: Loop, reason: Finding) -> None:
    """End a motion, also one that waits for its start, and an arming. A motion to the rest pose goes on."""
    busy = loop.executor.motion in (Motion.ACTIVE, Motion.STREAMING) or loop.executor.waiting
    if loop.procedures.rank is Priority.ARM:
        loop.procedures.own(Priority.DISARM, lambda: arming.give_up(loop))
    elif loop.procedures.rank is None and busy:
        loop.executor.stop("aborted", (reason,))


def _reachable(loop: Loop, news: link.Reachable, now: float) -> None:
    """Hold motion while no new client can connect; nothing moves by itself afterwards."""
    before = loop.unreachable
    loop.unreachable = Finding(ReasonCode.SOCKETS_GONE, message=news.missing) if news.missing else None
    for path in news.rebound:
        loop.say.event(
            "warning", ReasonCode.SOCKETS_GONE, f"{path} was removed or replaced; it is bound again"
        )
    if loop.unreachable is not None and before is None:
        loop.say.event("error", ReasonCode.SOCKETS_GONE, news.missing, (loop.unreachable,))
        _hold(loop, loop.unreachable)
    elif loop.unreachable is None and before is not None:
        loop.say.event("info", ReasonCode.SOCKETS_GONE, "clients can connect again; motion may be requested")
    loop.publisher.urgent = loop.publisher.urgent or loop.unreachable != before


# ------------------------------------------------------------------------------------------- mode, lease


def _set_mode(loop: Loop, command: link.SetMode, now: float) -> None:
    if command.mode not in [mode.value for mode in Mode]:
        names = [mode.value for mode in Mode]
        loop.say.error(command, "NotFound", what="mode", name=command.mode, known=names)
        return
    wanted = Mode(command.mode)
    if wanted is not loop.mode and (what := loop.homing.busy()):
        loop.say.error(command, "Busy", what=what)
        return
    refusal = mode_change(loop.mode, wanted, loop.state, loop.executor.motion)
    # where torque that was found on can be switched off
    to_live = loop.mode is Mode.MIRROR and wanted is Mode.LIVE
    if refusal is None and loop.energised and wanted is not loop.mode and not to_live:
        refusal = Finding(ReasonCode.MODE_DENIES, message="torque is on: disarm first")
    if refusal is None and wanted is Mode.LIVE:
        refusal = loop.parts.live_denied
    if refusal is not None:
        loop.say.refuse(command, (refusal,))
        return
    if wanted is not loop.mode:
        loop.enter(wanted)
        loop.publisher.urgent = True
    loop.say.reply(command, mode=loop.mode.value)


def _lease(loop: Loop, now: float) -> dict[str, Any]:
    """Return the lease as the interface encodes it."""
    info = loop.publisher.lease(now) or link.LeaseInfo(holder="", uid=-1, expires_in=0.0)
    return {"holder": info.holder, "uid": info.uid, "expires_in": info.expires_in}


def _acquire(loop: Loop, command: link.AcquireLease, now: float) -> None:
    held_by_other = loop.lease.holder_client(now) not in (0, command.client)
    if not loop.lease.acquire(command.client, command.holder, command.uid, now, take=command.take):
        loop.say.error(command, "LeaseHeld", lease=_lease(loop, now))
        return
    moving = loop.executor.motion in (Motion.ACTIVE, Motion.STREAMING)
    if held_by_other and moving and loop.procedures.rank is None:  # never the motion to the rest pose
        reason = Finding(ReasonCode.LEASE_LOST, message=f"the lease was taken by {command.holder}")
        loop.executor.stop("aborted", (reason,))  # taken from another: motion holds first
    if held_by_other:
        loop.say.event("warning", ReasonCode.LEASE_LOST, f"lease taken by {command.holder}")
    loop.publisher.urgent = True
    loop.say.reply(command, lease=_lease(loop, now))


def _renew(loop: Loop, command: link.RenewLease, now: float) -> None:
    if loop.lease.renew(command.client, now):
        loop.say.reply(command, lease=_lease(loop, now))
    else:
        loop.say.refuse(
            command, (Finding(ReasonCode.LEASE_MISSING, message="this connection does not hold the lease"),)
        )


def _release(loop: Loop, command: link.ReleaseLease, now: float) -> None:
    streaming = loop.executor.motion is Motion.STREAMING and loop.procedures.rank is None
    if loop.lease.held_by(command.client, now) and streaming:
        loop.executor.stop()
    loop.lease.release(command.client)
    loop.publisher.urgent = True
    loop.say.reply(command)


# ------------------------------------------------------------------------------------------- torque


def _arm(loop: Loop, command: link.Arm, now: float) -> None:
    everyone = list(range(len(loop.joints)))
    if command.joints is not None and sorted(command.joints) != everyone:
        finding = Finding(
            ReasonCode.BAD_SHAPE, message="arming some joints is not supported: name all, or none"
        )
        loop.say.refuse(command, (finding,))
        return
    _own(loop, command, Priority.ARM, lambda: arming.arm(loop, command, now))


def _disarm(loop: Loop, command: link.Disarm, now: float) -> None:
    if loop.torque_on and not loop.hardware.writers:
        message = f"mode {loop.mode} has nothing that writes: torque was found on; disarm in mode live"
        loop.say.refuse(command, (Finding(ReasonCode.MODE_DENIES, message=message),))
        return
    _own(loop, command, Priority.DISARM, lambda: torque_release.disarm(loop, command, now))


def _estop(loop: Loop, command: link.EStop, now: float) -> None:
    if command.level not in torque_release.RANKS:
        known = list(torque_release.RANKS)
        loop.say.error(command, "NotFound", what="level", name=command.level, known=known)
        return
    loop.latch(Finding(ReasonCode.ESTOP, message=command.reason or f"e-stop ({command.level})"))
    loop.stops.ask(command)
    if loop.stop_wanted and loop.torque_off:
        return  # nothing is left to stop, and the end of the daemon must not be put off for ever
    torque_release.stop(loop, command.level, now)


def _own(loop: Loop, command: link.Command, rank: Priority, start: Callable[[], Procedure]) -> None:
    if not loop.procedures.own(rank, start):
        running = loop.procedures.rank
        what = running.name.lower() if running is not None else "starting"
        loop.say.error(command, "Busy", what=f"{what}: {LOWERING}" if _lowering(loop) else what)


def _lowering(loop: Loop) -> bool:
    """Check for a procedure that leads to torque off."""
    return loop.procedures.rank is not None and loop.procedures.rank >= Priority.DISARM


def _reset(loop: Loop, command: link.Reset, now: float) -> None:
    """Acknowledge latches; torque must be off. Never arms: a fault that persists refuses the next Arm."""
    if loop.torque_on:
        allowed = f"torque off: {LOWERING if _lowering(loop) else 'disarm'}"
        loop.say.error(command, "WrongState", state=f"{loop.state.value}, torque on", allowed=[allowed])
        return
    wanted = set(command.codes) if command.codes is not None else {code.value for code in loop.latches}
    unknown = wanted - {code.value for code in loop.latches}
    if unknown:
        codes = [code.value for code in loop.latches]
        loop.say.error(command, "NotFound", what="latched code", name=sorted(unknown)[0], known=codes)
        return
    for code in [code for code in loop.latches if code.value in wanted]:
        del loop.latches[code]
    if ReasonCode.ESTOP not in loop.latches:
        loop.torque.lift_stop()
    if not loop.latches:
        if loop.torque.inhibited:
            for port in loop.hardware.ports:  # devices were not checked while inhibited: identify them anew
                port.identify()
        loop.torque.lift_inhibit()
        if loop.condition.latched or loop.state is RobotState.INHIBITED:
            loop.change(RobotEvent.RESET, now)
            loop.identity.settle_state(now)
        if loop.mode is not Mode.LIVE and (loop.executor.motion is Motion.IDLE or loop.twin.halted):
            loop.enter(loop.mode)  # the simulation takes goals again, from where it stopped
    loop.publisher.urgent = True
    loop.say.reply(command, state=loop.state.value)


# ------------------------------------------------------------------------------------------- marks

MARKS = {"begin": EventCode.EPISODE_BEGIN, "end": EventCode.EPISODE_END, "note": EventCode.NOTE}
ENDED = {True: "succeeded", False: "failed", None: "ended"}


def _mark(loop: Loop, command: link.Mark, now: float) -> None:
    annotation = command.annotation
    ended = ENDED[annotation.success] if annotation.kind == "end" else None
    words = [word for word in (annotation.task, ended, annotation.text) if word]
    loop.say.mark(command, MARKS[annotation.kind], ": ".join(words))


# ------------------------------------------------------------------------------------------- motion


def _cancel(loop: Loop, command: link.Cancel, now: float) -> None:
    if loop.procedures.rank is None:  # a robot on its way to the rest pose is stopping already
        loop.executor.stop()
    loop.say.reply(command, state=loop.state.value)


_HANDLERS: dict[type, Callable[[Any, Any, float], None]] = {
    link.ConnectionClosed: _gone,
    link.Reachable: _reachable,
    link.ReloadStarted: lambda loop, command, now: loop.reloads.begin(now),
    link.ReloadFailed: lambda loop, command, now: loop.reloads.failed(command.message),
    link.SetMode: _set_mode,
    link.AcquireLease: _acquire,
    link.RenewLease: _renew,
    link.ReleaseLease: _release,
    link.Arm: _arm,
    link.Disarm: _disarm,
    link.EStop: _estop,
    link.Reset: _reset,
    link.Calibrate: lambda loop, command, now: loop.calibrating.ask(command, now),
    link.FindStop: lambda loop, command, now: loop.homing.ask(command, now),
    link.Mark: _mark,
    link.Cancel: _cancel,
    link.Setpoint: lambda loop, command, now: loop.submissions.setpoint(command, now),
    link.ReadRegister: device_procedures.read,
    link.WriteRegister: device_procedures.write,
    link.Reboot: device_procedures.reboot,
    link.Scan: device_procedures.scan,
}
