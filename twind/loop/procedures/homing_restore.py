"""Restoring of a servo after an end-stop search: mode and settings are written back, read back, reported.

Until then no client arms, leaves the mode or writes to it. An interrupted attempt is repeated. A
servo that refuses, or another one in its place, ends the restoring, which is reported.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass, field
from typing import Any

from twind import link
from twind.config.calibrated_device import STAMPED
from twind.loop.procedures.homing_request import HomingRequest
from twind.loop.procedures.internal_faults import fail
from twind.loop.procedures.joint_verification import JointVerificationState
from twind.loop.procedures.procedure_context import ProcedureContext
from twind.loop.procedures.procedure_runner import Priority, Procedure, Steps, ticks
from twind.motion.endstop_search import LOST, HomingPhase
from twind.robot.event_codes import EventCode
from twind.robot.finding import Finding, ReasonCode
from twind.safety.multiturn import StatedPlace
from twind_drivers.bus import DeviceRefused, IdentifiedDevice, WireRangeError

REFUSALS = 3  # refusals of the servo after which restoring ends and is reported
RESTED = 32  # counts that a joint may move from its rest while its mode is restored, to keep its turn
RESTING = "the end-stop search"
PAUSE = 25  # ticks between two attempts, so that other requests get bus time
ANSWER = 3.0  # s after the end of the search by which the caller gets its reply, restored or not
ITS_OWN = ("drive_mode", "homing_offset", STAMPED)  # settings that identify the servo


@dataclass(eq=False)
class EndstopSearchRecord:
    """One end-stop search: its request, the servo's settings before it, and its result."""

    command: link.FindStop
    request: HomingRequest
    device: IdentifiedDevice  # as it was identified before
    kept: Any = None  # state of the driver for the restoring; None: nothing was written
    left: str = ""  # settings that stay changed without restoring
    watchdog: int = 0  # value of its watchdog register while it has torque
    shift: int = 0  # counts: calibrated count minus raw, in the present mode
    looked_after: bool = False  # True from agreeing readings until the search begins: an old reading ends it
    rest: int | None = None  # calibrated count at which it rests afterwards; None: its turn was known before
    # since then it moved, or it was silent since the first write: its count may be of another turn
    left_rest: bool = False
    powered: float | None = None  # s, when torque was read back on
    over: bool = False  # the search has ended, and its torque too, or another procedure takes it
    answered: bool = False
    reported: tuple[float, str] = (0.0, "")  # s and phase of the last report of progress
    captures: list[float] = field(default_factory=list)
    findings: tuple[Finding, ...] = ()


def give_back(
    context: ProcedureContext,
    pending: EndstopSearchRecord,
    verified: JointVerificationState,
    restored: Callable[[], None],
) -> Procedure:
    """Restore the servo once the search is over and torque is off, identify its bus anew, then reply.

    A turn that the search determined is given to `verified`. `restored` is called when it is done, or will
    never be.
    """
    while not pending.over:
        now = yield
        pending.left_rest = pending.left_rest or not _is_read(context, pending, now)
    steps = _give_back(context, pending, verified, restored)
    try:
        next(steps)
        while True:
            now = yield
            if pending.rest is not None and not _rests(context, pending, pending.rest, now):
                pending.left_rest = True
            steps.send(now)
    except StopIteration:
        return None


def _give_back(
    context: ProcedureContext,
    pending: EndstopSearchRecord,
    verified: JointVerificationState,
    restored: Callable[[], None],
) -> Steps:
    """Run all steps from the end of the search to the reply."""
    port = pending.request.port
    until = context.clock.now() + ANSWER
    why = yield from _returned(context, pending, until)
    pending.findings += why
    _report_restore(context, pending, why)
    restored()
    port.identify()
    while not (pending.answered or context.hardware.connected or context.condition.stop_wanted):
        if context.clock.now() >= until:
            break
        yield  # the client may go on at once after the reply
    if pending.rest is not None and not why and not pending.answered:
        pending.findings += yield from _turn_kept(pending, pending.rest, verified)
    answer(context, pending)


def _rests(context: ProcedureContext, pending: EndstopSearchRecord, rest: int, now: float) -> bool:
    """Check that the joint still rests at the count `rest`, whatever turn its mode counts from."""
    aim = pending.request
    raw = int(context.hardware.readings.raw.ticks[aim.joint])
    place = StatedPlace(rest, RESTED, RESTING)
    return _is_read(context, pending, now) and place.contradiction(aim.joint, raw, aim.turn) is None


def _is_read(context: ProcedureContext, pending: EndstopSearchRecord, now: float) -> bool:
    """Check that the joint is read: after a silence its servo may have restarted, on another turn."""
    return now - float(context.hardware.readings.raw.heard_at[pending.request.joint]) <= LOST


def _turn_kept(
    pending: EndstopSearchRecord, rest: int, verified: JointVerificationState
) -> Generator[None, float, tuple[Finding, ...]]:
    """Choose the turn of a joint that still rests at the count `rest`; return the findings of a failure.

    Its mode was changed meanwhile, which may have changed its count by whole turns.
    """
    joint = pending.request.joint
    against = None
    if not pending.left_rest:
        against = verified.locate(joint, StatedPlace(rest, RESTED, RESTING))
        for _ in range(PAUSE):
            if against is not None or verified.turn_known[joint]:
                break
            yield
        verified.withdraw([joint])
        if verified.turn_known[joint]:
            return ()
    message = "it moved or was silent before its mode was restored, or is silent: its turn stays unknown"
    return (against or Finding(ReasonCode.CALIB_MISMATCH, joint, message=message),)


def _returned(
    context: ProcedureContext, pending: EndstopSearchRecord, until: float
) -> Generator[None, float, tuple[Finding, ...]]:
    """Try to restore until it succeeds or never will; return the findings of the failure."""
    refusals = 0
    while True:
        # Another device may have the id by now; settings of the old one must not be written to it.
        if (strange := _stranger(pending)) is not None:
            return (unrestored(pending, strange),)
        if _free(context, pending):
            error = yield from _restored(pending)
            if isinstance(error, WireRangeError):
                return (clamped(context, pending, error), unrestored(pending, str(error)))
            if error is None:
                return ()
            refusals += isinstance(error, DeviceRefused | KeyError | ValueError)  # it was not cut short
            if refusals >= REFUSALS:
                return (unrestored(pending, str(error)),)
        if context.clock.now() > until:
            waits = "torque or bus do not allow it yet; it is tried again until they do"
            answer(context, pending, unrestored(pending, waits))
        yield from ticks(PAUSE)


def _free(context: ProcedureContext, pending: EndstopSearchRecord) -> bool:
    """Check that no other procedure runs, no torque is on, and the device is identified."""
    port = pending.request.port
    calm = (
        context.procedures.rank in (None, Priority.SHUTDOWN)
        and not context.torque.armed
        and not context.torque.energising
    )
    identified = port.identification is None and _now(pending) is not None
    return calm and identified and port.writer is not None and port.reader is not None and not port.full


def _now(pending: EndstopSearchRecord) -> IdentifiedDevice | None:
    """Return the device with that id as last identified; None: no reply since the bus was opened."""
    aim = pending.request
    found = (each for each in aim.port.devices if each.id == aim.id and each.settings)
    return next(found, None)


def _stranger(pending: EndstopSearchRecord) -> str | None:
    """Return the reason why the device with the id is not the one that was driven.

    None: no difference is known.
    """
    was = pending.device
    found = _now(pending)
    if found is None:
        return None
    for name, before, after in (
        ("model", was.model_number, found.model_number),
        ("firmware", was.firmware, found.firmware),
        ("unique id", was.unique_id, found.unique_id),
        *((name, was.settings.get(name), found.settings.get(name)) for name in ITS_OWN),
    ):
        if before != after:
            return f"another device has its id now ({name} was {before}, reads {after}): nothing was written"
    return None


def _restored(pending: EndstopSearchRecord) -> Generator[None, float, Exception | None]:
    """Try once to write the old mode and settings back; return the error of the attempt, or None."""
    port = pending.request.port
    aim = pending.request
    assert port.writer is not None
    try:
        alone = port.writer.begin_single_device(aim.id, cap=aim.cap, profile=aim.profile)
    except ValueError as error:
        return error
    finally:
        port.writer.end_single_device()  # the restoring writes are checked as any others
    task = port.run(alone.give_back(pending.kept))
    while not task.done:
        yield
    return task.error


def report_pending_restore(context: ProcedureContext, pending: EndstopSearchRecord) -> None:
    """Report that the daemon ends before mode and settings were written back."""
    why = unrestored(pending, "the daemon ends")
    _report_restore(context, pending, (why,))
    answer(context, pending, why)


# ------------------------------------------------------------------------------------------- reports


def answer(context: ProcedureContext, pending: EndstopSearchRecord, *more: Finding) -> None:
    """Send the last reply: captures, or findings; with any finding no capture is reported."""
    if pending.answered:
        return
    pending.answered = True
    findings = [*pending.findings, *more]
    name = context.robot.joints.names[pending.request.joint]
    if findings:
        message = f"{name}: its stop was not found: {findings[0].message}"
        context.reports.event("warning", findings[0].code, message, findings)
        context.reports.reply(
            pending.command, phase=HomingPhase.FAILED.value, progress=1.0, findings=findings
        )
        return
    counts = [round(count) for count in pending.captures]
    context.reports.event("info", EventCode.HOMING, f"{name}: its stop is at {counts}; torque is off")
    context.reports.reply(pending.command, phase=HomingPhase.FOUND.value, progress=1.0, ticks=counts)


def _report_restore(
    context: ProcedureContext, pending: EndstopSearchRecord, why: tuple[Finding, ...]
) -> None:
    """Report the result of the restoring as events, for a client answered before and for all others."""
    name = context.robot.joints.names[pending.request.joint]
    for finding in why:
        context.reports.event("error", finding.code, f"{name}: {finding.message}", (finding,))
    if pending.answered and not why:
        context.reports.event("info", EventCode.HOMING, f"{name}: its mode and settings are as they were")


def unrestored(pending: EndstopSearchRecord, why: str) -> Finding:
    """Build the finding of a servo that was not restored: what it is left with, and why."""
    message = f"its mode and settings are not as they were: {why}; it is left with {pending.left}"
    return Finding(ReasonCode.DEVICE_MISMATCH, pending.request.joint, message=message)


def clamped(context: ProcedureContext, pending: EndstopSearchRecord, error: WireRangeError) -> Finding:
    """Latch WIRE_CLAMP: bytes that may not leave are an internal fault."""
    finding = Finding(
        ReasonCode.WIRE_CLAMP, pending.request.joint, value=float(error.value), message=str(error)
    )
    fail(context, finding)
    return finding


def find_end_cause(context: ProcedureContext) -> Finding:
    """Return the reason why it was ended from outside."""
    for finding in context.condition.latches.values():
        return finding
    if context.condition.stop_wanted:
        return Finding(ReasonCode.NOT_ARMED, message="the daemon ends")
    return Finding(
        ReasonCode.NOT_ARMED,
        message=f"the robot is {context.condition.state.value}: it was disarmed, or a bus was lost",
    )
