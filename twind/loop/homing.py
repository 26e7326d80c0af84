"""A joint driven against its stop: one servo with torque, weak and slow, everybody else limp.

Readings agree, the servo goes into the mode that has a current cap, torque on, the course (`motion/homing`),
torque off. Whatever ends it, here or from outside, mode and settings are given back by a procedure that runs
beside and was begun before anything was written; that one answers.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from twind import link
from twind.loop.procedures import Procedure, Rank, ticks
from twind.loop.sought import Sought, sought
from twind.loop.torque import loosen
from twind.motion.homing import AGREE, Course, Look, Phase, Quiet
from twind.robot.arrays import some
from twind.robot.finding import Code, Finding
from twind.robot.modes import State
from twind.safety.device_rules import TRIPPED
from twind.safety.states import LATCHED
from twind_drivers.bus import BusError, DeviceRefused, Script

if TYPE_CHECKING:
    from twind.loop.tick import Loop
    from twind_drivers.alone import Alone

T = TypeVar("T")
PIN = "find stop"  # holds the lease while it lasts
REPORT = 0.25  # s between two reports of progress
SWINGS = 5  # times that goal := present is tried of a joint that moves
READ = 3  # ticks until readings are newer than what was just written
OFF_TURN = 16  # part of a turn that counts may be off a whole one when the mode changes
REFUSALS = 3  # times that a servo may refuse what it is given back
PAUSE = 25  # ticks between two tries
ANSWER = 3.0  # s after its end by which the caller is answered, given back or not


class Ended(Exception):
    """The search ends, torque goes off; the finding says why."""

    def __init__(self, finding: Finding) -> None:
        super().__init__(finding.message)
        self.finding = finding


@dataclass(eq=False)
class Debt:
    """One search: what was asked, what the servo was before, and how it came out."""

    command: link.FindStop
    sought: Sought
    kept: Any = None  # of the driver: what is given back; None: nothing was written
    shift: int = 0  # counts: calibrated count minus raw, in the mode that it is in now
    powered: float | None = None  # s, when torque was read back on
    over: bool = False  # the search has ended, and torque of ours with it, or is being taken
    captures: list[float] = field(default_factory=list)
    findings: tuple[Finding, ...] = ()


class Homing:
    """At most one search; `owed` until its servo is what it was."""

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self.owed: Debt | None = None
        self._told = (-1.0, "")  # s and phase of the last report

    def ask(self, command: link.FindStop, now: float) -> None:
        """Begin, or answer why not."""
        loop = self._loop
        if loop.state is not State.CALIBRATING and loop.state not in LATCHED:
            allowed = [State.CALIBRATING.value]
            loop.say.error(command, "WrongState", state=loop.state.value, allowed=allowed)
            return
        if self.owed is not None or loop.procedures.rank is not None:
            loop.say.error(command, "Busy", what="a joint is driven against its stop, or being given back")
            return
        found = sought(loop, command, now)
        if isinstance(found, list):
            loop.say.refuse(command, found)
            return
        loop.procedures.own(Rank.HOME, lambda: self._search(Debt(command, found)))

    # ------------------------------------------------------------------------------- the search

    def _search(self, debt: Debt) -> Procedure:
        loop = self._loop
        loop.lease.pin(debt.command.client, PIN)
        try:
            debt.findings = yield from self._outcome(debt)
            loop.hardware.clear()
            if loop.energising:
                debt.findings += yield from self._loosened(debt)
        except GeneratorExit:  # what took over takes the torque: `energising` is set
            debt.findings = debt.findings or (_cause(loop),)
            loop.unconfirmed = loop.unconfirmed or loop.energising
            loop.hardware.clear()
            raise
        finally:
            self._end(debt)

    def _outcome(self, debt: Debt) -> Generator[None, float, tuple[Finding, ...]]:
        """What went wrong; nothing: it was found."""
        loop, joint = self._loop, debt.sought.joint
        try:
            yield from self._found(debt)
        except Ended as ended:
            return (self._of(debt, ended.finding),)
        except ValueError as error:  # its model has no such mode, or not so little current
            return (Finding(Code.STOP_NOT_FOUND, joint, message=str(error)),)
        except BusError as error:
            return (Finding(Code.BUS_ERRORS, joint, message=str(error)),)
        except Exception as error:  # noqa: BLE001 - whatever broke, torque goes off
            broken = Finding(Code.INTERNAL, joint, message=repr(error))
            loop.fail(broken, loop.clock.now())
            return (broken,)
        return ()

    def _loosened(self, debt: Debt) -> Generator[None, float, tuple[Finding, ...]]:
        """Torque off, read back; what is to be said of it."""
        loop = self._loop
        try:
            yield from loosen(loop)
        except BusError as error:
            message = f"torque could not be read back off: {error}"
            loop.say.event("error", Code.TORQUE_MISMATCH, message)
            return (Finding(Code.TORQUE_MISMATCH, debt.sought.joint, message=message),)
        return ()

    @staticmethod
    def _of(debt: Debt, finding: Finding) -> Finding:
        """What the course says is of its joint."""
        own = (Code.STOP_NOT_FOUND, Code.OVERCURRENT, Code.STATE_STALE, Code.CALIB_MISMATCH)
        return replace(finding, joint=debt.sought.joint) if finding.code in own else finding

    def _end(self, debt: Debt) -> None:
        self._loop.lease.unpin(debt.command.client, PIN)
        debt.over = True
        if debt.kept is None:  # nobody runs beside it
            self._release(debt)
            self._answer(debt)

    def _found(self, debt: Debt) -> Generator[None, float, None]:
        """Everything from the first look to the last capture. Raises Ended, BusError, ValueError."""
        loop, aim = self._loop, debt.sought
        writer, command = aim.port.writer, debt.command
        assert writer is not None
        name = loop.joints.names[aim.joint]
        loop.say.event("info", "HOMING", f"{command.holder}: {name} goes to its {command.side} stop")
        debt.shift = int(loop.hardware.readings.shift[aim.joint])
        yield from self._quiet(debt)
        alone = writer.alone(aim.id, cap=aim.cap, profile=aim.profile)
        kept = yield from self._done(debt, alone.look())
        self.owed, debt.kept = debt, kept
        loop.procedures.beside(self._give_back(debt))
        held = yield from self._pinned(debt, alone, kept)
        now = yield from self._energised(debt, alone, held)
        yield from self._course(debt, alone, Course(aim.search, float(held), now), now)

    def _quiet(self, debt: Debt) -> Generator[None, float, None]:
        now = self._loop.clock.now()
        self._report(debt, "waiting", 0.0, now)
        now = yield
        quiet = Quiet(now)
        while (answer := quiet.step(self._look(debt), now)) is not True:
            if isinstance(answer, Finding):
                raise Ended(answer)
            now = yield
            self._require(debt, now)

    def _pinned(self, debt: Debt, alone: Alone, kept: Any) -> Generator[None, float, int]:
        """In its other mode, with goal := present read back; the count (calibrated) that it is to hold."""
        aim, before = debt.sought, self._count(debt)
        yield from self._done(debt, alone.enter(kept))
        yield from ticks(READ)
        debt.shift = _frame(before, before_raw := self._raw(debt), aim.turn)
        alone.bound(aim.lower - debt.shift, aim.upper - debt.shift)
        for _ in range(SWINGS):
            held = self._count(debt)
            yield from self._done(debt, alone.prepare(kept, held - debt.shift))
            if abs(self._count(debt) - held) <= AGREE:
                return held
        moved = float(abs(self._count(debt) - before_raw - debt.shift))
        message = "still moving (counts): let it hang still, then try again"
        raise Ended(Finding(Code.STOP_NOT_FOUND, value=moved, bound=float(AGREE), message=message))

    def _energised(self, debt: Debt, alone: Alone, held: int) -> Generator[None, float, float]:
        """Torque on, read back, and it did not jump; the time."""
        loop, aim = self._loop, debt.sought
        self._require(debt, (yield from ticks(1)))
        loop.energising = True
        yield from self._done(debt, alone.energise())
        debt.powered = loop.clock.now()
        now = yield from ticks(READ)
        jump = float(abs(self._count(debt) - held))
        if not jump <= aim.jump:
            message = "counts: it jumped when torque came on"
            raise Ended(Finding(Code.STOP_NOT_FOUND, value=jump, bound=aim.jump, message=message))
        return now

    def _course(self, debt: Debt, alone: Alone, course: Course, now: float) -> Generator[None, float, None]:
        while True:
            self._require(debt, now)
            goal = course.step(self._look(debt), now)
            if course.failed is not None:
                raise Ended(course.failed)
            if course.done:
                debt.captures = course.captures
                return
            alone.goal(round(goal) - debt.shift)
            self._report(debt, course.phase.value, course.progress, now)
            now = yield

    # ------------------------------------------------------------------------------- what ends it

    def _require(self, debt: Debt, now: float) -> None:
        """Raises Ended where anything says that this may not go on."""
        for finding in self._against(debt, now):
            raise Ended(finding)

    def _against(self, debt: Debt, now: float) -> Generator[Finding, None, None]:
        loop, joint = self._loop, debt.sought.joint
        if loop.state is not State.CALIBRATING or loop.latches:
            yield _cause(loop)
        if not loop.lease.held_by(debt.command.client, now):
            yield Finding(Code.LEASE_LOST, message="the lease is gone")
        yield from loop.parts.guard.bars
        if not loop.hardware.connected:
            yield Finding(Code.HW_DISCONNECTED, message="a bus was lost, or is asked anew who is there")
        slow = loop.hardware.slow
        on = slow.torque == 1
        on[joint] = False
        if some(on):
            other = int(np.argmax(on))
            yield Finding(Code.TORQUE_MISMATCH, other, value=1.0, bound=0.0, message="its torque is on")
        if debt.powered is None or not slow.status_time[joint] > debt.powered:
            return
        if slow.torque[joint] != 1:
            value = float(slow.torque[joint])
            yield Finding(Code.TORQUE_MISMATCH, joint, value=value, bound=1.0, message="torque went off")
        if slow.watchdog[joint] == TRIPPED:
            message = "its watchdog tripped: nobody spoke on its bus for too long"
            yield Finding(Code.WATCHDOG_TRIPPED, joint, value=float(TRIPPED), message=message)
        if slow.fault[joint] > 0:
            value = float(slow.fault[joint])
            yield Finding(Code.SERVO_ALERT, joint, value=value, bound=0.0, message="hardware error")

    def _done(self, debt: Debt, script: Script[T]) -> Generator[None, float, T]:
        """The result of a script, while nothing speaks against going on. Raises what it raises, Ended."""
        task = debt.sought.port.run(script, urgent=True)
        while not task.done:
            now = yield
            self._require(debt, now)
        if task.error is not None:
            raise task.error
        return task.result  # type: ignore[return-value]

    # ------------------------------------------------------------------------------- given back

    def _give_back(self, debt: Debt) -> Procedure:
        """Once it is over and torque is off: as it was, read back, identified anew. Then the answer."""
        loop, port, refusals = self._loop, debt.sought.port, 0
        while not debt.over:
            yield
        until, told = loop.clock.now() + ANSWER, False
        while True:
            if self._free(debt):
                error = yield from self._restored(debt)
                if error is None:
                    break
                refusals += isinstance(error, DeviceRefused)
                if refusals >= REFUSALS:
                    debt.findings += (_unrestored(debt, str(error)),)
                    break
            if loop.clock.now() > until and not told:
                told = True
                waits = "torque or bus do not allow it yet; it is tried again until they do"
                self._answer(debt, _unrestored(debt, waits))
            yield from ticks(PAUSE)
        self._release(debt)
        port.identify()
        while not told and not loop.hardware.connected and loop.clock.now() < until:
            yield  # so that whoever is answered may go on at once
        if not told:
            self._answer(debt)

    def _free(self, debt: Debt) -> bool:
        """Nobody else writes there, and no torque of ours is left."""
        loop, port = self._loop, debt.sought.port
        calm = loop.procedures.rank in (None, Rank.SHUTDOWN) and not loop.armed and not loop.energising
        return calm and port.writer is not None and port.reader is not None and not port.full

    def _restored(self, debt: Debt) -> Generator[None, float, Exception | None]:
        """One try; what was wrong with it."""
        port, aim = debt.sought.port, debt.sought
        assert port.writer is not None
        try:
            alone = port.writer.alone(aim.id, cap=aim.cap, profile=aim.profile)
        finally:
            port.writer.together()  # what is given back is judged as everybody's is
        task = port.run(alone.give_back(debt.kept))
        while not task.done:
            yield
        return task.error

    def _release(self, debt: Debt) -> None:
        writer = debt.sought.port.writer
        if writer is not None:
            writer.together()
        self.owed = None

    # ------------------------------------------------------------------------------- what is said

    def _report(self, debt: Debt, phase: str, progress: float, now: float) -> None:
        at, last = self._told
        if debt.command.more and (phase != last or not now - at < REPORT):
            self._told = (now, phase)
            self._loop.say.reply(debt.command, continues=True, phase=phase, progress=progress)

    def _answer(self, debt: Debt, *more: Finding) -> None:
        """The last answer: captures, or why there are none; nothing is found where anything is wrong."""
        loop, findings = self._loop, [*debt.findings, *more]
        name = loop.joints.names[debt.sought.joint]
        if findings:
            said = f"{name}: its stop was not found: {findings[0].message}"
            loop.say.event("warning", findings[0].code, said, findings)
            loop.say.reply(debt.command, phase=Phase.FAILED.value, progress=1.0, findings=findings)
            return
        counts = [round(count) for count in debt.captures]
        loop.say.event("info", "HOMING", f"{name}: its stop is at {counts}; torque is off")
        loop.say.reply(debt.command, phase=Phase.FOUND.value, progress=1.0, ticks=counts)

    # ------------------------------------------------------------------------------- what is read

    def _raw(self, debt: Debt) -> int:
        return int(self._loop.hardware.readings.raw.ticks[debt.sought.joint])

    def _count(self, debt: Debt) -> int:
        return self._raw(debt) + debt.shift

    def _look(self, debt: Debt) -> Look:
        raw, joint = self._loop.hardware.readings.raw, debt.sought.joint
        return Look(float(raw.heard_at[joint]), self._count(debt), float(raw.effort[joint]))


def _frame(before: int, raw: int, turn: int) -> int:
    """Whole turns between the calibrated count before and the raw one in the other mode. Raises Ended."""
    shift = turn * round((before - raw) / turn)
    off = abs(before - raw - shift)
    if off > turn / OFF_TURN:
        message = "counts that are no whole turn, when its mode changed: a homing offset beyond 1024?"
        raise Ended(Finding(Code.CALIB_MISMATCH, value=float(off), bound=turn / OFF_TURN, message=message))
    return shift


def _cause(loop: Loop) -> Finding:
    """Why it was ended from outside."""
    for finding in loop.latches.values():
        return finding
    if loop.stop_wanted:
        return Finding(Code.NOT_ARMED, message="the daemon ends")
    return Finding(Code.NOT_ARMED, message=f"the robot went to {loop.state.value}: disarmed, or a bus lost")


def _unrestored(debt: Debt, why: str) -> Finding:
    message = f"its mode and settings are not as they were: {why}"
    return Finding(Code.DEVICE_MISMATCH, debt.sought.joint, message=message)
