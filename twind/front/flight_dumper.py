"""Flight dumper: writes the flight recorder's files at a fault, on request, when the loop is gone.

Front process.

The ring is only read here, by its descriptor; a thread copies, packs and writes. A file that cannot be
written adds a line to the log and is counted.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from math import inf, isnan
from pathlib import Path

from twind.briefing import fingerprint
from twind.exceptions import InvalidInput
from twind.flight import copy, held_span, signature
from twind.front.client_calls import ClientCall
from twind.front.daemon_log import printable
from twind.front.flight_folder import CRASH, FAILSAFE, FlightFolder, meta_of, plain
from twind.front.front_core import FrontCore
from twind.front.state_cache import encode
from twind.link import CrashRecordingDone, Event
from twind.new_file import unwritten
from twind.robot.event_codes import EventCode
from twind.robot.modes import RESET_STATES

AFTERMATH = 2.0  # s after a fault that are in its file
AGAIN = 10.0  # s between two files of faults
CAUSE = 0.05  # s before a fault in which events count as its cause
LOOK = 1.0  # s between two checks of the ring's fill
ORPHANED = 0.3  # s after which a process whose parent has died has another one
# to write a crash of before; s between them: a disk may have room by then
WRECK_TRIES = 2
WRECK_AGAIN = 30.0
NAME = re.compile(r"[A-Za-z0-9_-]{1,64}")


@dataclass(frozen=True, slots=True)
class RecorderHandover:
    """Data that the loop hands over: descriptors of rings, which this process must close."""

    folder: Path
    ring: int | None = None  # the loop's
    wreck: int | None = None  # of a daemon before this one that is gone


@dataclass(frozen=True, slots=True)
class _FlightRequest:
    """Flight file to write: its ring, reason and label, and the call that requested it."""

    ring: int
    reason: str
    label: str
    call: ClientCall | None = None
    wreck: bool = False


class FlightDumper:
    """Queue of the files to write, and the record of those written."""

    def __init__(self, front: FrontCore, recorded: RecorderHandover | None) -> None:
        self._front = front
        self._parent = os.getppid()
        self._recorded = recorded or RecorderHandover(Path())
        self._folder = FlightFolder(self._recorded.folder)
        self._thread = ThreadPoolExecutor(1, "flight")
        self._causes: list[Event] = []
        self._due: float | None = None  # s, when the file of a fault is written
        # of the fault: the state, and the events just before
        self._reason = ""
        self._cause_codes = list[str]()
        self._next = self._look = 0.0  # s, earliest time of the next file; time of the next check of the ring
        self._farewell = False
        self._waiting_calls = 0  # number of calls that wait for their file
        self.last: str | None = None  # path of the last file
        self.failed = 0  # files that could not be written
        self._wreck_tries = 0
        self._wreck_due: float | None = None if self._recorded.wreck is None else -inf
        self._rescue(-inf)

    # ----------------------------------------------------------------------------- what makes one due

    def event(self, event: Event) -> None:
        """Process an event of the loop: a fault makes a file due."""
        self._farewell = self._farewell or event.code == EventCode.END
        if event.level in ("warning", "error"):
            self._causes = [each for each in self._causes if each.time >= event.time - CAUSE] + [event]
        if event.code in RESET_STATES and self._due is None:
            self._cause_codes = [each.code for each in self._causes if each.time >= event.time - CAUSE]
            self._reason = event.code
            self._due = max(self._front.now() + AFTERMATH, self._next)

    def housekeep(self, now: float) -> None:
        """Write what is due; called once per round of housekeeping."""
        if self._due is not None and now >= self._due:
            self._write_due()
        self._rescue(now)
        if now >= self._look:
            self._show(now)

    def _rescue(self, now: float) -> None:
        """Write the ring that an earlier daemon left, with one more attempt after a failure."""
        if self._wreck_due is not None and now >= self._wreck_due and self._recorded.wreck is not None:
            self._wreck_due = None
            self._wreck_tries = self._wreck_tries + 1
            self._begin(_FlightRequest(self._recorded.wreck, "crash", CRASH, wreck=True))

    def _show(self, now: float) -> None:
        """Put the state of the recorder into the status."""
        self._look = now + LOOK
        if self._recorded.ring is not None:
            oldest = None
            size = 0
            with contextlib.suppress(InvalidInput):
                oldest, size = held_span(self._recorded.ring)
            span = 0.0 if oldest is None or isnan(oldest) else max(0.0, now - oldest)
            self._front.world.flight = {"span_s": round(span, 1), "bytes": size, "last": self.last}

    def dump(self, call: ClientCall) -> None:
        """Execute `DumpRecorder`: write a file now, by that name."""
        name = call.parameters.get("name")
        if self._recorded.ring is None:
            call.error("NotWritten", {"path": "", "message": "nothing is recorded: the log has the reason"})
        elif name is not None and not NAME.fullmatch(name):
            message = printable(name[:40])
            call.invalid("name", f"{message!r} is no part of a file's name: 1 to 64 of A-Z a-z 0-9 _ -")
        elif name in (CRASH, FAILSAFE):
            call.invalid("name", f"{name} is what twind calls files of its own: choose another")
        elif self._waiting_calls:
            call.error("Busy", {"what": "another call: its file is being written"})
        else:
            self._waiting_calls += 1
            self._begin(_FlightRequest(self._recorded.ring, "dump", name or "DUMP", call))

    async def end(self) -> None:
        """The loop has gone: what is due is written now, and what it was doing if it took no farewell."""
        ring = self._recorded.ring
        if ring is not None and not self._farewell and await self._orphaned():
            self._begin(_FlightRequest(ring, "crash", CRASH))
        elif self._due is not None:
            self._write_due()
        await self._front.loop.run_in_executor(None, self._thread.shutdown)
        await asyncio.sleep(0)  # the result is reported
        for fd in (self._recorded.ring, self._recorded.wreck):
            if fd is not None:
                os.close(fd)

    async def _orphaned(self) -> bool:
        """Return True if the loop has died, False if it goes on with another front."""
        await asyncio.sleep(ORPHANED)
        return os.getppid() != self._parent

    # ----------------------------------------------------------------------------- writing

    def _write_due(self) -> None:
        self._due = None
        self._next = self._front.now() + AGAIN
        if self._recorded.ring is not None:
            self._begin(_FlightRequest(self._recorded.ring, self._reason, self._cause()))

    def _cause(self) -> str:
        """Return the code that names the file.

        This is the first latched code among the events just before the fault, else the last of those events.
        """
        overview = self._front.world.overview
        latched = {finding.code.value for finding in overview.faults} if overview is not None else set()
        last = self._cause_codes[-1] if self._cause_codes else self._reason.upper()
        return next((code for code in self._cause_codes if code in latched), last)

    def _begin(self, wanted: _FlightRequest) -> None:
        """Start writing in the thread; the result is reported from this one."""
        briefing = self._front.world.briefing
        tick = None if wanted.wreck else self._front.world.tick
        state = () if tick is None else (tick.mode, tick.state)
        meta = meta_of(briefing, wanted.reason, wanted.label, *state)

        def work() -> Path | None:
            if wanted.wreck:
                meta["files"] = self._files(wanted.ring)
            return self._folder.write(wanted.label, meta, plain(briefing), copy(wanted.ring))

        def done(future: Future[Path | None]) -> None:
            with contextlib.suppress(RuntimeError):  # the front has ended
                self._front.loop.call_soon_threadsafe(self._done, future, wanted)

        try:
            future = self._thread.submit(work)
        except RuntimeError as error:  # no thread is to be had, and it would be done when one is: too late
            self._thread = ThreadPoolExecutor(1, "flight")
            self._failed(error, wanted)
        else:
            future.add_done_callback(done)

    def _files(self, crash_recording: int) -> str:
        """Return True if the daemon that ended began with the files and the version of the briefing."""
        signed = signature(crash_recording)
        briefing = self._front.world.briefing
        if not any(signed):
            return "unknown"
        return "same" if signed == fingerprint(briefing.version, briefing.files) else "other"

    def _done(self, future: Future[Path | None], wanted: _FlightRequest) -> None:
        """Report the result to the log and to the caller."""
        error = future.exception()
        if error is not None:
            self._failed(error, wanted)
            return
        path = future.result()
        now = self._front.now()
        if path is None:
            said = "another crash of this robot was written down in the last minute"
            self._front.log.write("info", EventCode.FLIGHT_LEFT_OUT, now, message=said)
        else:
            self.last = str(path)
            self._show(now)
            self._front.log.write("info", EventCode.FLIGHT_WRITTEN, now, message=f"{path} ({wanted.reason})")
        self._answer(wanted, None if path is None else encode({"path": str(path)}), message="it was left out")
        if wanted.wreck:
            self._front.link.owe(CrashRecordingDone())

    def _failed(self, error: BaseException, wanted: _FlightRequest) -> None:
        """Report a failed write. The ring of an earlier daemon is kept, and written in a second attempt."""
        self.failed += 1
        now = self._front.now()
        why = unwritten(error) if isinstance(error, OSError) else str(error)
        said = f"{self._folder.path}: {why}"
        self._front.log.write("error", EventCode.FLIGHT_NOT_WRITTEN, now, message=said, failed=self.failed)
        self._answer(wanted, None, message=why)
        if wanted.wreck and self._wreck_tries < WRECK_TRIES:
            self._wreck_due = now + WRECK_AGAIN
        elif wanted.wreck:
            self._front.link.owe(CrashRecordingDone())

    def _answer(self, wanted: _FlightRequest, reply: bytes | None, *, message: str) -> None:
        """Answer the caller, whatever the result."""
        if wanted.call is None:
            return
        self._waiting_calls -= 1
        if reply is not None:
            wanted.call.reply(reply)
        else:
            wanted.call.error("NotWritten", {"path": str(self._folder.path), "message": message})
