"""Handler of each command of the front: a reply at once, or a procedure begun. Loop's process."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from twind import link
from twind.loop.ipc.call_outcome import CallOutcome, CallReply
from twind.loop.ipc.front_link import ReceivedCommand
from twind.loop.procedures import arming
from twind.loop.procedures.calibrating_state import CalibratingState
from twind.loop.procedures.daemon_shutdown import shutdown
from twind.loop.procedures.device_procedures import DeviceCommands
from twind.loop.procedures.estop_replies import EStopReplies
from twind.loop.procedures.gate_input import GateInput
from twind.loop.procedures.homing_procedure import HomingProcedure
from twind.loop.procedures.identification import IdentificationState
from twind.loop.procedures.internal_faults import fail
from twind.loop.procedures.joint_location import JointLocation
from twind.loop.procedures.mode_entry import ModeEntry
from twind.loop.procedures.procedure_context import ProcedureContext
from twind.loop.procedures.procedure_runner import Ending, Priority, Procedure
from twind.loop.procedures.reload_coordinator import ReloadCoordinator
from twind.loop.procedures.torque_readback import torque_denial, torque_on
from twind.loop.procedures.torque_release import STOPS, TorqueRelease
from twind.loop.procedures.trajectory_submissions import TrajectorySubmissions
from twind.loop.tick.loop_figures import LoopFigures
from twind.loop.tick.loop_parts import LoopParts
from twind.robot.event_codes import EventCode
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode, Motion, RobotState
from twind.safety.state_machine import RobotEvent, mode_change

LOWERING = "wait until torque is off, as `twindctl status --joints` shows"
MARKS = {"begin": EventCode.EPISODE_BEGIN, "end": EventCode.EPISODE_END, "note": EventCode.NOTE}
ENDED = {True: "succeeded", False: "failed", None: "ended"}


class CommandHandlers:
    """Handlers of all commands, and the parts of the loop that only commands reach."""

    def __init__(
        self,
        context: ProcedureContext,
        parts: LoopParts,
        identity: IdentificationState,
        release: TorqueRelease,
        modes: ModeEntry,
        figures: LoopFigures,
        troubles: Callable[[], Sequence[Finding]],
    ) -> None:
        """`troubles`: returns the findings that prevent arming."""
        self._context = context
        self._parts = parts
        self._identity = identity
        self._modes = modes
        self.gate_input = GateInput(context, parts, figures, troubles)
        self._calibrating = CalibratingState(context, parts.lease, identity)
        self._arming_client = 0  # client whose Arm is under way
        self.release = release
        self.stops = EStopReplies(context)
        self.submissions = TrajectorySubmissions(context, parts, self.gate_input, figures)
        self.homing = HomingProcedure(context, parts, self.gate_input, identity.verified)
        self.reloads = ReloadCoordinator(context, parts, self.gate_input, self.homing)
        location = JointLocation(context, parts.lease, identity.verified)
        devices = DeviceCommands(context, self.homing, self._calibrating)
        self._handlers: dict[type, Callable[[Any, float], None]] = {
            link.ConnectionClosed: self._close_connection,
            link.Reachable: self._note_reachable,
            link.ReloadStarted: lambda command, now: self.reloads.begin(now),
            link.ReloadFailed: lambda command, now: self.reloads.failed(command.message),
            link.SetMode: self._set_mode,
            link.AcquireLease: self._acquire,
            link.RenewLease: self._renew,
            link.ReleaseLease: self._release_lease,
            link.Arm: self._arm,
            link.Disarm: self._disarm,
            link.EStop: self._estop,
            link.Reset: self._reset,
            link.Calibrate: self._calibrating.ask,
            link.FindStop: self.homing.ask,
            link.LocateJoints: location.ask,
            link.Mark: self._mark,
            link.Cancel: self._cancel,
            link.Setpoint: lambda command, now: self.submissions.setpoint(command, now),
            link.ReadRegister: devices.read,
            link.WriteRegister: devices.write,
            link.Reboot: devices.reboot,
            link.Scan: devices.scan,
        }

    def serve(self, now: float) -> None:
        """Serve all commands and pending requests of this tick.

        An e-stop precedes all others: a command of the same tick must not start a motion that it should stop.
        """
        context = self._context
        incoming = self._parts.link.commands(now)
        incoming.sort(key=lambda each: not isinstance(each.command, link.EStop))
        for each in incoming:
            try:
                self.begin(each, now)
            except Exception as error:  # noqa: BLE001 - an error in one call must not affect the others
                fail(context, Finding(ReasonCode.INTERNAL, message=repr(error)))
                if isinstance(each.command, link.Command):
                    context.reports.error(each.command, "Busy", what=f"failed inside: {error!r}")
        if self._parts.link.lost:
            self._lose_front()
        self._calibrating.end_if_due(now)
        self.reloads.serve(now)
        if context.condition.stop_wanted:
            self._shut_down(now)

    def _shut_down(self, now: float) -> None:
        """Begin the end of the daemon; torque that is going off goes off, whoever switched it on."""
        context = self._context
        releasing = self._lowering()
        if context.procedures.own(
            Priority.SHUTDOWN,
            lambda: shutdown(context, self.release, self.homing, now, releasing=releasing),
        ):
            lowering = ": lowering the robot" if context.torque.armed or releasing else ""
            context.reports.event("info", EventCode.STOPPING, f"the daemon ends{lowering}")

    def begin(self, incoming: ReceivedCommand, now: float) -> None:
        """Reply to a command, or start the procedure whose outcome is the reply."""
        command = incoming.command
        if isinstance(command, link.Submit):
            self.submissions.begin(command, incoming.data, now)
        elif isinstance(command, link.ApplyChanges):
            self.reloads.adopt(command, incoming.fd, now)
        else:
            self._handlers[type(command)](command, now)

    def _close_connection(self, command: link.ConnectionClosed, now: float) -> None:
        """Process a closed connection: its lease lapses, and an arming that it began ends with torque off."""
        context = self._context
        self._parts.lease.release_client(command.client)
        self.submissions.drop_client(command.client)
        self.stops.drop_client(command.client)
        if context.procedures.rank is Priority.ARM and self._arming_client == command.client:
            context.procedures.own(Priority.DISARM, lambda: arming.give_up(context))

    def _lose_front(self) -> None:
        """Process the loss of the front and of every connection: leases lapse, motion holds, torque stays."""
        context = self._context
        self._parts.link.lost = False
        self._parts.lease.front_lost()
        self.submissions.forget()
        self._hold(Finding(ReasonCode.LEASE_LOST, message="the front was lost"))
        context.reports.event("error", ReasonCode.LEASE_LOST, "the front was lost; a new one is started")
        self.reloads.front_lost()

    def _hold(self, reason: Finding) -> None:
        """End a motion, also one that waits for its start, and an arming. A way to the rest pose goes on."""
        context = self._context
        busy = context.executor.motion in (Motion.ACTIVE, Motion.STREAMING)
        if context.procedures.rank is Priority.ARM:
            context.procedures.own(Priority.DISARM, lambda: arming.give_up(context))
        elif context.procedures.rank is None and busy:
            context.executor.stop("aborted", (reason,))

    def _note_reachable(self, news: link.Reachable, now: float) -> None:
        """Hold motion while no new client can connect; nothing moves by itself afterwards."""
        context = self._context
        before = context.condition.unreachable
        context.condition.unreachable = (
            Finding(ReasonCode.SOCKETS_GONE, message=news.missing) if news.missing else None
        )
        for path in news.rebound:
            context.reports.event(
                "warning", ReasonCode.SOCKETS_GONE, f"{path} was removed or replaced; it is bound again"
            )
        if context.condition.unreachable is not None and before is None:
            context.reports.event(
                "error", ReasonCode.SOCKETS_GONE, news.missing, (context.condition.unreachable,)
            )
            self._hold(context.condition.unreachable)
        elif context.condition.unreachable is None and before is not None:
            context.reports.event(
                "info", ReasonCode.SOCKETS_GONE, "clients can connect again; motion may be requested"
            )
        context.reports.urgent = context.reports.urgent or context.condition.unreachable != before

    # ------------------------------------------------------------------------------------------- mode, lease

    def _set_mode(self, command: link.SetMode, now: float) -> None:
        context = self._context
        if command.mode not in [mode.value for mode in Mode]:
            names = [mode.value for mode in Mode]
            context.reports.error(command, "NotFound", what="mode", name=command.mode, known=names)
            return
        wanted = Mode(command.mode)
        if wanted is not context.condition.mode and (what := self.homing.busy()):
            context.reports.error(command, "Busy", what=what)
            return
        refusal = mode_change(
            context.condition.mode, wanted, context.condition.state, context.executor.motion
        )
        # where torque that was found on can be switched off
        to_live = context.condition.mode is Mode.MIRROR and wanted is Mode.LIVE
        if refusal is None and wanted is not context.condition.mode and not to_live:
            refusal = torque_denial(context)
        if refusal is None and wanted is Mode.LIVE:
            refusal = self._parts.live_denied
        if refusal is not None:
            context.reports.refuse(command, (refusal,))
            return
        if wanted is not context.condition.mode:
            self._modes.enter(wanted)
            context.reports.urgent = True
        context.reports.reply(command, mode=context.condition.mode.value)

    def _lease(self, now: float) -> dict[str, Any]:
        """Return the lease as the interface encodes it."""
        held = self._parts.lease.info(now)
        if held is None:
            return {"holder": "", "uid": -1, "expires_in": 0.0}
        return {"holder": held.holder, "uid": held.uid, "expires_in": held.expires_in}

    def _acquire(self, command: link.AcquireLease, now: float) -> None:
        context = self._context
        held_by_other = self._parts.lease.holder_client(now) not in (0, command.client)
        if not self._parts.lease.acquire(command.client, command.holder, command.uid, now, take=command.take):
            context.reports.error(command, "LeaseHeld", lease=self._lease(now))
            return
        moving = context.executor.motion in (Motion.ACTIVE, Motion.STREAMING)
        # also one whose lease ended in this tick: it would go on beside the first motion of the new holder
        theirs = moving and self.submissions.epoch != self._parts.lease.epoch
        if theirs and context.procedures.rank is None:  # never the motion to the rest pose
            reason = Finding(ReasonCode.LEASE_LOST, message=f"the lease was taken by {command.holder}")
            context.executor.stop("aborted", (reason,))  # taken from another: motion holds first
        if held_by_other:
            context.reports.event("warning", ReasonCode.LEASE_LOST, f"lease taken by {command.holder}")
        context.reports.urgent = True
        context.reports.reply(command, lease=self._lease(now))

    def _renew(self, command: link.RenewLease, now: float) -> None:
        context = self._context
        if self._parts.lease.renew(command.client, now):
            context.reports.reply(command, lease=self._lease(now))
        else:
            context.reports.refuse(
                command,
                (Finding(ReasonCode.LEASE_MISSING, message="this connection does not hold the lease"),),
            )

    def _release_lease(self, command: link.ReleaseLease, now: float) -> None:
        context = self._context
        streaming = context.executor.motion is Motion.STREAMING and context.procedures.rank is None
        if self._parts.lease.held_by(command.client, now) and streaming:
            context.executor.stop()
        self._parts.lease.release(command.client)
        context.reports.urgent = True
        context.reports.reply(command)

    # ------------------------------------------------------------------------------------------- torque

    def _arm(self, command: link.Arm, now: float) -> None:
        context = self._context
        limp = np.zeros(len(context.robot.joints), np.bool_)
        if command.joints is not None:
            limp = ~np.isin(np.arange(len(limp)), command.joints)
        judge = partial(self.gate_input.may_arm, command.client, limp=limp)
        if self._own(
            command,
            Priority.ARM,
            lambda: arming.arm(context, judge, command.edited, limp, now),
            lambda outcome: self._arm_ended(command, outcome),
        ):
            self._arming_client = command.client

    def _arm_ended(self, command: link.Arm, outcome: CallOutcome | None) -> None:
        """Reply to an arming. The simulation follows from where the robot is held."""
        context = self._context
        commanded = context.robot.commanded
        if isinstance(outcome, CallReply) and commanded is not None:
            self._parts.twin.place(commanded)
        self._reply(command, outcome)
        unwatched = outcome.parameters.get("warnings", ()) if isinstance(outcome, CallReply) else ()
        if unwatched:
            message = f"{len(unwatched)} joints {arming.UNWATCHED}"
            context.reports.event("warning", ReasonCode.DEVICE_MISMATCH, message, tuple(unwatched))

    def _disarm(self, command: link.Disarm, now: float) -> None:
        context = self._context
        if torque_on(context) and not context.hardware.writers:
            mode = context.condition.mode
            message = f"mode {mode} has nothing that writes: torque was found on; disarm in mode live"
            context.reports.refuse(command, (Finding(ReasonCode.MODE_DENIES, message=message),))
            return
        self._own(command, Priority.DISARM, self.release.disarm, partial(self._reply, command))

    def _estop(self, command: link.EStop, now: float) -> None:
        context = self._context
        if command.level not in STOPS:
            known = list(STOPS)
            context.reports.error(command, "NotFound", what="level", name=command.level, known=known)
            return
        self.stops.ask(command)
        self.release.request_stop(command.level, command.reason or f"e-stop ({command.level})")

    def _own(
        self, command: link.Command, rank: Priority, start: Callable[[], Procedure], ended: Ending
    ) -> bool:
        """Begin a procedure that owns the torque; False after the reply that another one runs."""
        context = self._context
        if context.procedures.own(rank, start, ended):
            return True
        running = context.procedures.rank
        assert running is not None  # it was not begun as that one runs
        what = running.name.lower()
        context.reports.error(command, "Busy", what=f"{what}: {LOWERING}" if self._lowering() else what)
        return False

    def _reply(self, command: link.Command, outcome: CallOutcome | None) -> None:
        """Send the outcome of a procedure."""
        assert outcome is not None  # arming and disarming always have one
        self._context.reports.answer(command, outcome)

    def _lowering(self) -> bool:
        """Check for a procedure that leads to torque off."""
        context = self._context
        return context.procedures.rank is not None and context.procedures.rank >= Priority.DISARM

    def _reset(self, command: link.Reset, now: float) -> None:
        """Acknowledge latches; torque must be off, and no procedure on its way there.

        Never arms: a fault that persists refuses the next Arm. An e-stop that still runs does not begin
        again, so one after a reset would not be latched.
        """
        context = self._context
        if torque_on(context) or self._lowering():
            allowed = f"torque off: {LOWERING if self._lowering() else 'disarm'}"
            torque = "torque on" if torque_on(context) else "torque going off"
            state = f"{context.condition.state.value}, {torque}"
            context.reports.error(command, "WrongState", state=state, allowed=[allowed])
            return
        codes = [code.value for code in context.condition.latches]
        wanted = codes if command.codes is None else command.codes
        unknown = set(wanted) - set(codes)
        if unknown:
            context.reports.error(
                command, "NotFound", what="latched code", name=sorted(unknown)[0], known=codes
            )
            return
        context.condition.acknowledge(wanted)
        if ReasonCode.ESTOP not in context.condition.latches:
            context.torque.lift_stop()
        if not context.condition.latches:
            if context.torque.inhibited:
                for (
                    port
                ) in context.hardware.ports:  # devices were not checked while inhibited: identify them anew
                    port.identify()
            context.torque.lift_inhibit()
            if context.condition.latched or context.condition.state is RobotState.INHIBITED:
                context.condition.change(RobotEvent.RESET)
                self._identity.settle_state(now)
            if context.condition.mode is not Mode.LIVE and (
                context.executor.motion is Motion.IDLE or self._parts.twin.halted
            ):
                self._modes.enter(
                    context.condition.mode
                )  # the simulation takes goals again, from where it stopped
        context.reports.urgent = True
        context.reports.reply(command, state=context.condition.state.value)

    def _mark(self, command: link.Mark, now: float) -> None:
        context = self._context
        annotation = command.annotation
        ended = ENDED[annotation.success] if annotation.kind == "end" else None
        words = [word for word in (annotation.task, ended, annotation.text) if word]
        context.reports.mark(command, MARKS[annotation.kind], ": ".join(words))

    # ------------------------------------------------------------------------------------------- motion

    def _cancel(self, command: link.Cancel, now: float) -> None:
        context = self._context
        if context.procedures.rank is None:  # a robot on its way to the rest pose is stopping already
            self.submissions.stop(command.client, now)
        elif context.procedures.rank is Priority.HOME:
            self.homing.cancel()
        context.reports.reply(command, state=context.condition.state.value)
