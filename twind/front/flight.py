"""When the flight recorder is written out: at a fault, when asked, when the loop is gone. Front process.

The ring is only read here, by its descriptor; a thread copies, packs and writes. What cannot be written costs
a line of the log and is counted.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
import threading
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from twind.flight import copy, held
from twind.front.calls import Call
from twind.front.flight_folder import CRASH, Folder, meta_of, plain
from twind.front.log import printable
from twind.front.world import encode
from twind.link import Event
from twind.robot.modes import State

if TYPE_CHECKING:
    from twind.front.server import Front

FAULTS = {State.FAULT.value, State.ESTOP.value, State.INHIBITED.value}  # what an operator must acknowledge
AFTERMATH = 2.0  # s after a fault that are in its file
AGAIN = 10.0  # s between two files of faults
CAUSE = 0.05  # s before a fault in which its cause was told
LOOK = 1.0  # s between two looks at how much the ring holds
ORPHANED = 0.3  # s after which a process whose parent has died has another one
NAME = re.compile(r"[A-Za-z0-9_-]{1,64}")


@dataclass(frozen=True, slots=True)
class Recorded:
    """What the loop hands over: descriptors of rings, which are ours to close."""

    folder: Path
    ring: int | None = None  # the loop's
    wreck: int | None = None  # of a daemon before this one that is gone


class Flights:
    """What waits to be written, and what was."""

    def __init__(self, front: Front, recorded: Recorded | None) -> None:
        self._front, self._parent = front, os.getppid()
        self._recorded = recorded or Recorded(Path())
        self._folder = Folder(self._recorded.folder)
        self._thread = ThreadPoolExecutor(1, "flight", _stand_back)
        self._causes: list[Event] = []
        self._due: float | None = None  # s, when the file of a fault is written
        self._reason, self._told = "", list[str]()  # of it: the state, and what was told just before
        self._next = self._look = 0.0  # s, before which no other is; when the ring is looked at again
        self._farewell = False
        self._asked = 0  # calls that wait for their file
        self.last: str | None = None  # path of the last file
        self.failed = 0  # files that could not be written
        if self._recorded.wreck is not None:
            self._begin(self._recorded.wreck, "crash", CRASH, wreck=True)

    # ----------------------------------------------------------------------------- what makes one due

    def event(self, event: Event) -> None:
        """Something the loop says: a fault makes a file due."""
        self._farewell = self._farewell or event.code == "END"
        if event.level in ("warning", "error"):
            self._causes = [each for each in self._causes if each.time >= event.time - CAUSE] + [event]
        if event.code in FAULTS and self._due is None:
            self._told = [each.code for each in self._causes if each.time >= event.time - CAUSE]
            self._reason, self._due = event.code, max(self._front.now() + AFTERMATH, self._next)

    def tend(self, now: float) -> None:
        """Once per round of housekeeping."""
        if self._due is not None and now >= self._due:
            self._write_due()
        if now >= self._look:
            self._show(now)

    def _show(self, now: float) -> None:
        """In the status."""
        self._look = now + LOOK
        if self._recorded.ring is not None:
            oldest, size = held(self._recorded.ring)
            span = 0.0 if oldest is None else max(0.0, now - oldest)
            self._front.world.flight = {"span_s": round(span, 1), "bytes": size, "last": self.last}

    def dump(self, call: Call) -> None:
        """`DumpRecorder`: now, by that name."""
        name = call.parameters.get("name")
        if self._recorded.ring is None:
            call.error("NotWritten", {"path": "", "message": "nothing is recorded: the log says why"})
        elif name is not None and not NAME.fullmatch(name):
            said = printable(name[:40])
            call.invalid("name", f"{said!r} is no part of a file's name: 1 to 64 of A-Z a-z 0-9 _ -")
        elif self._asked:
            call.error("Busy", {"what": "another call: its file is being written"})
        else:
            self._asked += 1
            self._begin(self._recorded.ring, "dump", name or "DUMP", call)

    async def end(self) -> None:
        """The loop has gone: what is due is written now, and what it was doing if it took no farewell."""
        ring = self._recorded.ring
        if ring is not None and not self._farewell and await self._orphaned():
            self._begin(ring, "crash", CRASH)
        elif self._due is not None:
            self._write_due()
        await self._front.loop.run_in_executor(None, self._thread.shutdown)
        await asyncio.sleep(0)  # what became of it is told

    async def _orphaned(self) -> bool:
        """The loop has died; else it has only let go of us, and goes on with another front."""
        await asyncio.sleep(ORPHANED)
        return os.getppid() != self._parent

    # ----------------------------------------------------------------------------- writing

    def _write_due(self) -> None:
        self._due, self._next = None, self._front.now() + AGAIN
        if self._recorded.ring is not None:
            self._begin(self._recorded.ring, self._reason, self._cause())

    def _cause(self) -> str:
        """Of what was told just before the fault, what is latched; else the last of it."""
        overview = self._front.world.overview
        latched = {finding.code.value for finding in overview.faults} if overview is not None else set()
        last = self._told[-1] if self._told else self._reason.upper()
        return next((code for code in self._told if code in latched), last)

    def _begin(
        self, ring: int, reason: str, label: str, call: Call | None = None, *, wreck: bool = False
    ) -> None:
        """Into the thread; what became of it is told from this one."""
        briefing, tick = self._front.world.briefing, None if wreck else self._front.world.tick
        meta = meta_of(briefing, reason, label, *(() if tick is None else (tick.mode, tick.state)))

        def work() -> Path | None:
            try:
                packed = copy(ring)
            finally:
                if wreck:
                    os.close(ring)
            return self._folder.write(label, meta, plain(briefing), packed)

        def done(future: Future[Path | None]) -> None:
            with contextlib.suppress(RuntimeError):  # the front has ended
                self._front.loop.call_soon_threadsafe(self._tell, future, reason, call)

        self._thread.submit(work).add_done_callback(done)

    def _tell(self, future: Future[Path | None], reason: str, call: Call | None) -> None:
        """To the log, and to who asked."""
        self._asked -= call is not None
        now, error = self._front.now(), future.exception()
        if error is not None:
            self.failed += 1
            said = f"{self._folder.path}: {error}"
            self._front.log.say("error", "FLIGHT_NOT_WRITTEN", now, message=said, failed=self.failed)
            if call is not None:
                call.error("NotWritten", {"path": str(self._folder.path), "message": str(error)})
        elif (path := future.result()) is None:
            said = "another crash of this robot was written down in the last minute"
            self._front.log.say("info", "FLIGHT_LEFT_OUT", now, message=said)
        else:
            self.last = str(path)
            self._show(now)
            self._front.log.say("info", "FLIGHT_WRITTEN", now, message=f"{path} ({reason})")
            if call is not None:
                call.reply(encode({"path": str(path)}))


def _stand_back() -> None:
    """The lowest priority for the thread that packs: a loop without real time rights has the same core."""
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), 19)
