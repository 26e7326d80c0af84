"""Restoring of a servo after a search for its stop: mode and settings are written back, read back, reported.

Until then the joint is owed: no client arms, leaves the mode or writes to it. An interrupted try is made
again. A servo that refuses, or another one in its place, ends the restoring, and that is reported.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from twind import link
from twind.loop.homing_request import HomingRequest
from twind.loop.procedures import Priority, Procedure, ticks
from twind.motion.endstop_search import HomingPhase
from twind.robot.finding import Finding, ReasonCode
from twind_drivers.bus import DeviceRefused, IdentifiedDevice, WireClamp

if TYPE_CHECKING:
    from twind.loop.tick import Loop

REFUSALS = 3  # times that a servo may refuse what it is given back
PAUSE = 25  # ticks between two tries
ANSWER = 3.0  # s after its end by which the caller is answered, given back or not
ITS_OWN = ("drive_mode", "homing_offset", "moving_threshold")  # settings by which a servo is known again


@dataclass(eq=False)
class PendingRestore:
    """One end-stop search: its request, the servo's settings before it, and its result."""

    command: link.FindStop
    sought: HomingRequest
    device: IdentifiedDevice  # as it was identified before
    kept: Any = None  # of the driver: what is given back; None: nothing was written
    left: str = ""  # what it is left with, if it is not given back
    watchdog: int = 0  # what its watchdog reads while it has torque
    shift: int = 0  # counts: calibrated count minus raw, in the mode that it is in now
    looked_after: bool = False  # an old reading ends it: from when they agreed until the course begins
    powered: float | None = None  # s, when torque was read back on
    over: bool = False  # the search has ended, and torque of ours with it, or is being taken
    answered: bool = False
    captures: list[float] = field(default_factory=list)
    findings: tuple[Finding, ...] = ()


def give_back(loop: Loop, debt: PendingRestore) -> Procedure:
    """Once it is over and torque is off: as it was, read back, identified anew. Then the answer."""
    port = debt.sought.port
    while not debt.over:
        yield
    until = loop.clock.now() + ANSWER
    why = yield from _returned(loop, debt, until)
    debt.findings += why
    _report_restore(loop, debt, why)
    release(loop, debt)
    port.identify()
    while not debt.answered and not loop.hardware.connected and loop.clock.now() < until:
        yield  # so that whoever is answered may go on at once
    answer(loop, debt)


def _returned(loop: Loop, debt: PendingRestore, until: float) -> Generator[None, float, tuple[Finding, ...]]:
    """Try to restore until it succeeds or never will; return the findings of the failure."""
    refusals = 0
    while True:
        if (strange := _stranger(debt)) is not None:
            return (unrestored(debt, strange),)
        if _free(loop, debt):
            error = yield from _restored(debt)
            if isinstance(error, WireClamp):
                return (clamped(loop, debt, error), unrestored(debt, str(error)))
            if error is None:
                return ()
            refusals += isinstance(error, DeviceRefused | KeyError | ValueError)  # it was not cut short
            if refusals >= REFUSALS:
                return (unrestored(debt, str(error)),)
        if loop.clock.now() > until and not debt.answered:
            waits = "torque or bus do not allow it yet; it is tried again until they do"
            answer(loop, debt, unrestored(debt, waits))
        yield from ticks(PAUSE)


def _free(loop: Loop, debt: PendingRestore) -> bool:
    """Check that no other procedure writes there, that our torque is off, and that the device at the id is
    identified."""
    port = debt.sought.port
    calm = loop.procedures.rank in (None, Priority.SHUTDOWN) and not loop.armed and not loop.energising
    known = port.identification is None and _now(debt) is not None
    return calm and known and port.writer is not None and port.reader is not None and not port.full


def _now(debt: PendingRestore) -> IdentifiedDevice | None:
    """Return the device that has the id of `debt`, as last identified; None: it has not answered since the
    bus was opened."""
    found = (each for each in debt.sought.port.devices if each.id == debt.sought.id and each.settings)
    return next(found, None)


def _stranger(debt: PendingRestore) -> str | None:
    """Return the reason why the device that has the id now is not the one that was driven; None: no
    difference is known."""
    was = debt.device
    found = _now(debt)
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


def _restored(debt: PendingRestore) -> Generator[None, float, Exception | None]:
    """Try once to write the old mode and settings back; return the error of the attempt, or None."""
    port = debt.sought.port
    aim = debt.sought
    assert port.writer is not None
    try:
        alone = port.writer.begin_single_device(aim.id, cap=aim.cap, profile=aim.profile)
    except ValueError as error:
        return error
    finally:
        port.writer.end_single_device()  # what is given back is judged as everybody's is
    task = port.run(alone.give_back(debt.kept))
    while not task.done:
        yield
    return task.error


def report_pending_restore(loop: Loop, debt: PendingRestore) -> None:
    """Report that the daemon ends before mode and settings were written back."""
    why = unrestored(debt, "the daemon ends")
    _report_restore(loop, debt, (why,))
    answer(loop, debt, why)


def release(loop: Loop, debt: PendingRestore) -> None:
    """End the debt; all devices on its bus are written to again."""
    if debt.sought.port.writer is not None:
        debt.sought.port.writer.end_single_device()
    loop.homing.owed = None


# ------------------------------------------------------------------------------------------- what is said


def answer(loop: Loop, debt: PendingRestore, *more: Finding) -> None:
    """The last answer: captures, or why there are none; nothing is found where anything is wrong."""
    if debt.answered:
        return
    debt.answered = True
    findings = [*debt.findings, *more]
    name = loop.joints.names[debt.sought.joint]
    if findings:
        said = f"{name}: its stop was not found: {findings[0].message}"
        loop.say.event("warning", findings[0].code, said, findings)
        loop.say.reply(debt.command, phase=HomingPhase.FAILED.value, progress=1.0, findings=findings)
        return
    counts = [round(count) for count in debt.captures]
    loop.say.event("info", "HOMING", f"{name}: its stop is at {counts}; torque is off")
    loop.say.reply(debt.command, phase=HomingPhase.FOUND.value, progress=1.0, ticks=counts)


def _report_restore(loop: Loop, debt: PendingRestore, why: tuple[Finding, ...]) -> None:
    """Report the result of the restoring as events, for a client answered before and for all others."""
    name = loop.joints.names[debt.sought.joint]
    for finding in why:
        loop.say.event("error", finding.code, f"{name}: {finding.message}", (finding,))
    if debt.answered and not why:
        loop.say.event("info", "HOMING", f"{name}: its mode and settings are as they were")


def unrestored(debt: PendingRestore, why: str) -> Finding:
    """Build the finding of a servo that was not restored: what it is left with, and why."""
    message = f"its mode and settings are not as they were: {why}; it is left with {debt.left}"
    return Finding(ReasonCode.DEVICE_MISMATCH, debt.sought.joint, message=message)


def clamped(loop: Loop, debt: PendingRestore, error: WireClamp) -> Finding:
    """WIRE_CLAMP: bytes that may not leave are a fault of ours, and latch as everywhere."""
    finding = Finding(ReasonCode.WIRE_CLAMP, debt.sought.joint, value=float(error.value), message=str(error))
    loop.fail(finding, loop.clock.now())
    return finding
