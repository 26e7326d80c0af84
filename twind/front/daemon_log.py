"""Daemon log: structured lines, written by a separate thread. Front process.

Where standard error is the journal's, lines go there as datagrams of fields (`systemd_journal.py`); else to
standard error as text. A slow or absent reader or a full disk blocks no client and ends nothing: the lines
are dropped and counted, and the count is reported with the next line that can be written.
"""

import contextlib
import json
import os
import queue
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from twind.front import systemd_journal as journals
from twind.robot.event_codes import EventCode

WAITING = 1000  # lines that may wait for a slow standard error
PER_SECOND = 20  # lines of one kind; the rest of that second is counted
PRIORITY = journals.PRIORITY
LEVELS = {"debug": 10, "info": 20, "warning": 30, "error": 40, "critical": 50}

Fields = dict[str, Any]


@dataclass(frozen=True, slots=True)
class LogLine:
    """One line, and the same as a datagram for the journal."""

    text: str
    datagram: bytes = b""


class LogWriter:
    """Lines to a descriptor, or to the journal's socket, written by a thread."""

    def __init__(self, fd: int, journal: str | None = None) -> None:
        """`journal`: path of its socket; what it does not take goes to `fd`."""
        self._fd = fd
        self._partly = False
        self._lines: queue.Queue[LogLine | None] = queue.Queue(WAITING)
        self.dropped = 0  # lines, in all, for which there was no room; counted by the caller
        self.failed = 0  # lines, in all, that could not be written; counted by the thread
        self._journal = journals.SystemdJournal(journal) if journal is not None else None
        self._thread = threading.Thread(target=self._run, name="log", daemon=True)
        self._thread.start()

    @property
    def dropped_lines(self) -> int:
        """Number of lines that were lost."""
        return self.dropped + self.failed

    def put(self, line: LogLine | str) -> None:
        """Write `line` soon, or drop and count it. Never waits."""
        try:
            self._lines.put_nowait(LogLine(line) if isinstance(line, str) else line)
        except queue.Full:
            self.dropped += 1

    def close(self, patience: float = 0.5) -> None:
        """Write what waits, for at most `patience` s."""
        with contextlib.suppress(queue.Full):
            self._lines.put_nowait(None)
        self._thread.join(patience)

    def _run(self) -> None:
        reported = 0
        while (line := self._lines.get()) is not None:
            total = self.dropped_lines
            if total > reported and self._write(_loss(total - reported)):
                reported = total
            if not self._write(line):
                self.failed += 1
        if self._journal is not None:
            self._journal.close()

    def _write(self, line: LogLine) -> bool:
        """Write to the journal, or else to the descriptor; return False if neither accepted the line."""
        if self._journal is not None and line.datagram and self._journal.send(line.datagram):
            return True
        begin = "\n" if self._partly else ""  # half a line stands there since the disk was full
        data = memoryview((begin + line.text + "\n").encode("utf-8", "backslashreplace"))
        whole = len(data)
        while data:
            try:
                data = data[os.write(self._fd, data) :]
            except OSError:  # full, closed or gone: it may take the next one
                self._partly = self._partly or len(data) < whole
                return False
        self._partly = False
        return True


def _loss(count: int) -> LogLine:
    said = f"... {count} lines lost (standard error not read, closed, or its disk full)"
    fields = {
        "MESSAGE": said,
        "PRIORITY": "4",
        "TWIND_CODE": EventCode.LINES_LOST.value,
        "TWIND_LINES": count,
    }
    return LogLine(said, journals.datagram(fields))


class DaemonLog:
    """Log of the daemon. `event` names are fixed; text of clients goes to fields only."""

    def __init__(self, writer: LogWriter, level: str, *, journal: bool) -> None:
        """Open the log; `journal`: path of its socket; lines that it does not accept go to `fd`."""
        self._writer = writer
        self._render = _for_journal if journal else _for_people
        self.level(level)
        self._allowances = {kind: _LineBudget() for kind in ("client", "error", "other")}

    def level(self, level: str) -> None:
        """Drop lines below this level from now on."""
        self._least = LEVELS.get(level, LEVELS["info"])

    def write(
        self, level: str, event: str, now: float, details: Mapping[str, Any] | None = None, **fields: Any
    ) -> None:
        """Write one line. `details` are fields for programs; the message contains them as text.

        At most `PER_SECOND` lines of a kind in a second of `now`; the next one reports the number dropped.
        Lines caused by clients (`holder`), errors and the rest have separate budgets: a flood of one hides no
        other.
        """
        weight = LEVELS.get(level, LEVELS["info"])
        kind = "client" if "holder" in fields else "error" if weight >= LEVELS["error"] else "other"
        left_out = self._allowances[kind].take(now)
        if left_out is None or weight < self._least:
            return
        if left_out:
            fields = {**fields, "lines_left_out": left_out}
        known = {key: value for key, value in (details or {}).items() if value is not None}
        whole: Fields = {"details": known, **fields, "event": str(event), "level": level}
        self._writer.put(self._render({key: _harmless(value) for key, value in whole.items()}))

    def close(self) -> None:
        """Write what waits."""
        self._writer.close()


class _LineBudget:
    """Budget of `PER_SECOND` lines in a second."""

    def __init__(self) -> None:
        self._second = 0.0
        self._count = 0
        self._left_out = 0

    def take(self, now: float) -> int | None:
        """Return the number of lines dropped before this one; None: this one is dropped, too."""
        if now - self._second >= 1.0:
            self._second = now
            self._count = 0
        self._count += 1
        if self._count > PER_SECOND:
            self._left_out += 1
            return None
        left_out = self._left_out
        self._left_out = 0
        return left_out


def _harmless(value: Any) -> Any:
    """Escape control characters, line breaks and text directions of clients for terminal and journal."""
    if isinstance(value, dict):
        return {key: _harmless(each) for key, each in value.items()}
    return printable(value) if isinstance(value, str) else value


def printable(text: str) -> str:
    """The text with what is no visible character or space written as an escape."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def _for_journal(fields: Fields) -> LogLine:
    """A datagram; and JSON with a level prefix, for when its socket does not take that."""
    details = fields.pop("details")
    text = f"<{PRIORITY.get(fields['level'], 6)}>"
    text += json.dumps({**fields, **details}, ensure_ascii=False, default=str)
    sent: dict[str, object] = {
        "MESSAGE": _sentence(dict(fields)),
        "PRIORITY": PRIORITY.get(fields["level"], 6),
        "TWIND_CODE": fields["event"],
    }
    others = {**fields, **details}
    sent |= {f"TWIND_{key.upper()}": value for key, value in others.items() if key not in _SAID}
    return LogLine(text, journals.datagram(sent))


_SAID = frozenset({"event", "level", "message"})  # stand in fields of the journal's own


def _for_people(fields: Fields) -> LogLine:
    fields.pop("details")
    return LogLine(f"{datetime.now():%H:%M:%S} {fields['level']:<7} {_sentence(fields)}")


def _sentence(fields: Fields) -> str:
    """Format `EVENT: message key=value ...`."""
    head = fields.pop("event")
    message = fields.pop("message", None)
    fields.pop("level")
    tail = "".join(f" {key}={_value(value)}" for key, value in fields.items() if value is not None)
    return f"{head}: {message}{tail}" if message else head + tail


def _value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    return repr(value) if isinstance(value, str) and " " in value else str(value)
