"""End-stop search: drives one joint, weak and slow, against its stop; all other joints have no torque.

Order: readings agree, the servo enters the mode with a current cap, torque on, the search
(`motion/endstop_search`), torque off. However it ends, another procedure restores mode and settings. That
procedure runs beside, starts before anything is written, and sends the reply.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

from twind import link
from twind.loop.ipc.call_outcome import CallOutcome
from twind.loop.procedures.gate_input import GateInput
from twind.loop.procedures.homing_conditions import servo_findings
from twind.loop.procedures.homing_request import resolve_request, turns_between
from twind.loop.procedures.homing_restore import (
    EndstopSearchRecord,
    answer,
    clamped,
    find_end_cause,
    give_back,
    report_pending_restore,
)
from twind.loop.procedures.internal_faults import fail
from twind.loop.procedures.joint_verification import JointVerificationState
from twind.loop.procedures.procedure_context import ProcedureContext
from twind.loop.procedures.procedure_runner import Priority, Procedure, ProcedureFailed
from twind.loop.procedures.torque_switching import switch_torque_off
from twind.loop.tick.loop_parts import LoopParts
from twind.motion.endstop_search import AGREE, LOST, EndstopSearch, HomingSample, StandstillCheck
from twind.robot.event_codes import EventCode
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import RobotState
from twind.safety.state_machine import LATCHED
from twind_drivers.bus import BusError, Script, WireRangeError
from twind_drivers.single_device import SingleDeviceControl

T = TypeVar("T")
PIN = "find stop"  # holds the lease while the search lasts
REPORT = 0.25  # s between two reports of progress
SWINGS = 5  # attempts of goal := present on a joint that moves; without a bound the search would never reply
READ = 3  # ticks until readings are newer than the last write; an older one shows the state before it


class HomingProcedure:
    """At most one search. `unrestored` is set until the mode and settings of its servo are restored."""

    def __init__(
        self,
        context: ProcedureContext,
        parts: LoopParts,
        gate_input: GateInput,
        verified: JointVerificationState,
    ) -> None:
        self._context = context
        self._lease = parts.lease
        self._guard = parts.guard
        self._gate_input = gate_input
        self._verified = verified
        self.unrestored: EndstopSearchRecord | None = None
        self._cancelled: bool  # a client ended the search that runs; False at its begin

    def ask(self, command: link.FindStop, now: float) -> None:
        """Begin a search, or reply with the reason why not."""
        context = self._context
        state = context.condition.state
        if state not in (RobotState.CALIBRATING, *LATCHED):
            allowed = [RobotState.CALIBRATING.value]
            context.reports.error(command, "WrongState", state=state.value, allowed=allowed)
            return
        if self.unrestored is not None or context.procedures.rank is not None:
            context.reports.error(command, "Busy", what="an end-stop search or its restoring is under way")
            return
        if (occupied := next((port.name for port in context.hardware.ports if port.busy), None)) is not None:
            what = f"a client reads, writes, scans or reboots on bus {occupied}: try again"
            context.reports.error(command, "Busy", what=what)
            return
        found = resolve_request(context, self._gate_input, self._verified, command, now)
        if isinstance(found, list):
            context.reports.refuse(command, found)
            return
        device = next(each for each in found.port.devices if each.id == found.id)
        pending = EndstopSearchRecord(command, found, device)
        end = partial(self._end, pending)
        self._cancelled = False
        try:
            context.procedures.own(Priority.HOME, lambda: self._search(pending), end)
        except Exception:
            self._finish(pending)  # whoever serves the call replies to it
            raise

    def cancel(self) -> None:
        """End the search that runs: torque goes off, and the servo is restored."""
        self._cancelled = True

    def busy(self, bus: str | None = None, id: int | None = None) -> str:
        """Return the text on what must end before that device may be changed; empty: nothing.

        Without arguments it covers all devices.
        """
        unrestored = self.unrestored
        if unrestored is None or (bus, id) not in (
            (None, None),
            (unrestored.request.port.name, unrestored.request.id),
        ):
            return ""
        return f"{self._context.robot.joints.names[unrestored.request.joint]} gets its mode and settings back"

    def report_pending_restore(self) -> None:
        """Report what is not restored yet when the daemon ends."""
        if self.unrestored is not None:
            report_pending_restore(self._context, self.unrestored)

    # ------------------------------------------------------------------------------- the search

    def _search(self, pending: EndstopSearchRecord) -> Procedure:
        """Search, then switch torque off. The findings of `pending` are its result; `_end` processes it."""
        context = self._context
        self._lease.pin(pending.command.client, PIN)
        pending.findings = yield from self._outcome(pending, self._run_search(pending))
        context.hardware.clear()
        if context.torque.energising:
            pending.findings += yield from self._switch_torque_off(pending)
        if pending.request.search.turn and not pending.findings:
            pending.findings = yield from self._outcome(pending, self._come_to_rest(pending))
        return None

    def _end(self, pending: EndstopSearchRecord, outcome: CallOutcome | None) -> None:
        """Process the end of a search. An outcome is the reason why it was ended by force.

        The procedure that takes over switches torque off, as `energising` is set.
        """
        if outcome is not None:
            pending.findings = pending.findings or (find_end_cause(self._context),)
            self._context.torque.abandon_switching()
            self._context.hardware.clear()
        self._finish(pending)
        if pending.kept is None:
            answer(self._context, pending)

    def _finish(self, pending: EndstopSearchRecord) -> None:
        """End a search. A procedure that restores its servo goes on."""
        self._lease.unpin(pending.command.client, PIN)
        pending.over = True
        if pending.kept is None:  # no restoring procedure runs
            self._restored(pending)

    def _restored(self, pending: EndstopSearchRecord) -> None:
        """End the obligation to restore; all devices on its bus are written to again."""
        if pending.request.port.writer is not None:
            pending.request.port.writer.end_single_device()
        self.unrestored = None
        self._verified.unrestored = None

    def _outcome(
        self, pending: EndstopSearchRecord, steps: Generator[None, float, None]
    ) -> Generator[None, float, tuple[Finding, ...]]:
        """Run these steps and return the findings of their failure."""
        context = self._context
        joint = pending.request.joint
        try:
            yield from steps
        except ProcedureFailed as ended:
            return (self._attach_joint(pending, ended.finding),)
        except ValueError as error:  # its model has no such mode, or not so small a current
            return (Finding(ReasonCode.STOP_NOT_FOUND, joint, message=str(error)),)
        except WireRangeError as error:
            return (clamped(context, pending, error),)
        except BusError as error:
            return (Finding(ReasonCode.BUS_ERRORS, joint, message=str(error)),)
        except Exception as error:  # noqa: BLE001 - any failure switches torque off
            broken = Finding(ReasonCode.INTERNAL, joint, message=repr(error))
            fail(context, broken)
            return (broken,)
        return ()

    def _switch_torque_off(self, pending: EndstopSearchRecord) -> Generator[None, float, tuple[Finding, ...]]:
        """Switch torque off and read it back; return the findings of a failure."""
        context = self._context
        try:
            yield from switch_torque_off(context)
        except BusError as error:
            message = f"torque could not be read back off: {error}"
            context.reports.event("error", ReasonCode.TORQUE_MISMATCH, message)
            return (Finding(ReasonCode.TORQUE_MISMATCH, pending.request.joint, message=message),)
        return ()

    @staticmethod
    def _attach_joint(pending: EndstopSearchRecord, finding: Finding) -> Finding:
        """Return `finding` with the joint, where the search itself reported it without one."""
        own = (
            ReasonCode.STOP_NOT_FOUND,
            ReasonCode.OVERCURRENT,
            ReasonCode.STATE_STALE,
            ReasonCode.CALIB_MISMATCH,
        )
        unnamed = finding.joint is None and finding.code in own
        return replace(finding, joint=pending.request.joint) if unnamed else finding

    def _run_search(self, pending: EndstopSearchRecord) -> Generator[None, float, None]:
        """Run all steps from first reading to last capture. Raises ProcedureFailed, BusError, ValueError."""
        context = self._context
        aim = pending.request
        writer = aim.port.writer
        command = pending.command
        assert writer is not None
        name = context.robot.joints.names[aim.joint]
        context.reports.event(
            "info", EventCode.HOMING, f"{command.holder}: {name} goes to its {command.side} stop"
        )
        pending.shift = aim.shift
        yield from self._quiet(pending)
        context.hardware.clear()  # no queued request may reach the servo between its checks and torque
        alone = writer.begin_single_device(aim.id, cap=aim.cap, profile=aim.profile)
        kept = yield from self._done(pending, alone.look())
        # What is kept is recorded before the first write: a search that ends now is still restored.
        pending.left = alone.describe_leftovers(kept)
        pending.watchdog = alone.watchdog
        self.unrestored = pending
        message = f"not restored after an end-stop search yet: it has {pending.left}"
        self._verified.unrestored = Finding(ReasonCode.CALIB_MISMATCH, aim.joint, message=message)
        pending.kept = kept
        restoring = give_back(context, pending, self._verified, lambda: self._restored(pending))
        context.procedures.beside(restoring)
        held = yield from self._pinned(pending, alone, kept)
        now = yield from self._energised(pending, alone, held)
        yield from self._course(pending, alone, EndstopSearch(aim.search, float(held), now), now)

    def _quiet(self, pending: EndstopSearchRecord) -> Generator[None, float, None]:
        now = self._context.clock.now()
        self._report(pending, "waiting", 0.0, now)
        now = yield
        quiet = StandstillCheck(now)
        while (answer := quiet.step(self._sample(pending), now)) is not True:
            if isinstance(answer, Finding):
                raise ProcedureFailed(answer)
            now = yield
            self._require(pending, now)
        pending.looked_after = True

    def _come_to_rest(self, pending: EndstopSearchRecord) -> Generator[None, float, None]:
        """Note where the limp joint rests: from there its turn is known once its mode is restored."""
        pending.powered = None
        yield from self._quiet(pending)
        pending.rest = self._count(pending)

    def _newer(self, pending: EndstopSearchRecord) -> Generator[None, float, float]:
        """Wait for a reading newer than all writes so far; return the time. Raises ProcedureFailed."""
        since = self._context.clock.now()
        passed = 0
        while True:
            now = yield
            self._require(pending, now)
            passed += 1
            if passed >= READ and self._sample(pending).at > since:
                return now

    def _pinned(
        self, pending: EndstopSearchRecord, alone: SingleDeviceControl, kept: Any
    ) -> Generator[None, float, int]:
        """Enter the other mode, set goal := present and read it back.

        Return the count (calibrated) to hold.
        """
        aim = pending.request
        before = self._count(pending)
        yield from self._done(pending, alone.enter_current_mode(kept))
        yield from self._newer(pending)
        pending.shift = turns_between(before, self._raw(pending), aim.turn)
        # Another mode may count from another turn: the clamp (WIRE_CLAMP) must be in its counts before any
        # goal.
        alone.set_goal_limits(aim.lower - pending.shift, aim.upper - pending.shift)
        for _ in range(SWINGS):
            held = self._count(pending)
            if not aim.lower <= held <= aim.upper:
                break
            yield from self._done(pending, alone.prepare(kept, held - pending.shift))
            yield from self._newer(pending)
            if abs(self._count(pending) - held) <= AGREE:
                return held
        moved = abs(self._count(pending) - before)
        message = "still moving (counts): let it hang still, then try again"
        raise ProcedureFailed.measured(ReasonCode.STOP_NOT_FOUND, moved, AGREE, message)

    def _energised(
        self, pending: EndstopSearchRecord, alone: SingleDeviceControl, held: int
    ) -> Generator[None, float, float]:
        """Switch torque on, read it back and check that the joint did not jump; return the time, s."""
        context = self._context
        aim = pending.request
        # Set before the write: whatever ends the search from here on must switch torque off.
        context.torque.begin_energising()
        yield from self._done(pending, alone.energise())
        pending.powered = context.clock.now()
        now = yield from self._newer(pending)
        jump = abs(self._count(pending) - held)
        if not jump <= aim.jump:
            message = "counts: it jumped when torque came on"
            raise ProcedureFailed.measured(ReasonCode.STOP_NOT_FOUND, jump, aim.jump, message)
        return now

    def _course(
        self, pending: EndstopSearchRecord, alone: SingleDeviceControl, course: EndstopSearch, now: float
    ) -> Generator[None, float, None]:
        pending.looked_after = False  # the search checks the age of readings itself
        while True:
            self._require(pending, now)
            goal = course.step(self._sample(pending), now)
            if course.failed is not None:
                raise ProcedureFailed(course.failed)
            if course.done:
                pending.captures = [count - course.turns_off for count in course.captures]
                pending.shift -= round(course.turns_off)
                return
            alone.goal(round(goal) - pending.shift)
            self._report(pending, course.phase.value, course.progress, now)
            now = yield

    # ------------------------------------------------------------------------------- what ends it

    def _require(self, pending: EndstopSearchRecord, now: float) -> None:
        """Raises ProcedureFailed where a condition forbids to continue."""
        for finding in self._against(pending, now):
            raise ProcedureFailed(finding)

    def _against(self, pending: EndstopSearchRecord, now: float) -> Generator[Finding, None, None]:
        context = self._context
        if context.condition.state is not RobotState.CALIBRATING or context.condition.latches:
            yield find_end_cause(context)
        if self._cancelled:
            yield Finding(ReasonCode.STOP_NOT_FOUND, message="a client cancelled the search")
        if not self._lease.held_by(pending.command.client, now):
            yield Finding(ReasonCode.LEASE_LOST, message="the lease is gone")
        yield from self._guard.bars
        if context.condition.unreachable is not None:
            yield context.condition.unreachable
        if not context.hardware.connected:
            yield Finding(
                ReasonCode.HW_DISCONNECTED, message="a bus was lost, or its devices are identified anew"
            )
        if pending.looked_after and not (age := now - self._sample(pending).at) <= LOST:
            message = "s since its last reading: check cable and power"
            yield Finding(ReasonCode.STATE_STALE, value=age, bound=LOST, message=message)
        yield from servo_findings(context, pending)

    def _done(self, pending: EndstopSearchRecord, script: Script[T]) -> Generator[None, float, T]:
        """Return a script's result, while all conditions hold. Raises its errors and ProcedureFailed."""
        task = pending.request.port.run(script, urgent=True)
        while not task.done:
            now = yield
            self._require(pending, now)
        if task.error is not None:
            raise task.error
        return task.result  # type: ignore[return-value]

    # ------------------------------------------------------------------------------- reports

    def _report(self, pending: EndstopSearchRecord, phase: str, progress: float, now: float) -> None:
        at, last = pending.reported
        if pending.command.more and (phase != last or not now - at < REPORT):
            pending.reported = (now, phase)
            self._context.reports.reply(pending.command, continues=True, phase=phase, progress=progress)

    # ------------------------------------------------------------------------------- readings

    def _raw(self, pending: EndstopSearchRecord) -> int:
        return int(self._context.hardware.readings.raw.ticks[pending.request.joint])

    def _count(self, pending: EndstopSearchRecord) -> int:
        return self._raw(pending) + pending.shift

    def _sample(self, pending: EndstopSearchRecord) -> HomingSample:
        raw = self._context.hardware.readings.raw
        joint = pending.request.joint
        return HomingSample(float(raw.heard_at[joint]), self._count(pending), float(raw.effort[joint]))
