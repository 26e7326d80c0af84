"""Logs of the daemon: structured lines to standard error, by a thread of their own. Front process.

A blocked reader of standard error never blocks a client: lines beyond a bounded queue are dropped and
counted. At the journal's end lines are JSON with a level prefix, else text for people.
"""

import contextlib
import json
import os
import queue
import threading
from collections.abc import MutableMapping
from typing import Any

import structlog

WAITING = 1000  # lines that may wait for a slow standard error
PER_SECOND = 20  # lines of one kind; the rest of that second is counted
LEVELS = {"debug": 10, "info": 20, "warning": 30, "error": 40, "critical": 50}
_ERROR = LEVELS["error"]
_PREFIX = {"debug": 7, "info": 6, "warning": 4, "error": 3, "critical": 2}  # sd-daemon(3)

Fields = MutableMapping[str, Any]


class Writer:
    """Lines to a descriptor, written by a thread."""

    def __init__(self, fd: int) -> None:
        self._fd = fd
        self._lines: queue.Queue[str | None] = queue.Queue(WAITING)
        self.dropped = 0  # lines, in all; counted by who puts, reported by the thread
        self._thread = threading.Thread(target=self._run, name="log", daemon=True)
        self._thread.start()

    def put(self, line: str) -> None:
        """Write `line` soon, or drop and count it. Never waits."""
        try:
            self._lines.put_nowait(line)
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
            total = self.dropped
            dropped, reported = total - reported, total
            lost = f"... {dropped} lines lost: standard error was not read\n" if dropped else ""
            data = memoryview((lost + line + "\n").encode("utf-8", "backslashreplace"))
            while data:
                try:
                    data = data[os.write(self._fd, data) :]
                except OSError:  # nobody reads any more: there is nowhere to say so
                    return


class Log:
    """What the daemon tells people. `event` names are ours; what clients say stands in fields only."""

    def __init__(self, writer: Writer, level: str, *, journal: bool) -> None:
        self._writer = writer
        render = _for_journal if journal else _for_people
        stamp = [] if journal else [structlog.processors.TimeStamper("%H:%M:%S", utc=False, key="at")]
        self._logger = structlog.wrap_logger(
            _Sink(writer),
            processors=[structlog.processors.add_log_level, *stamp, _escaped, render],
            wrapper_class=structlog.make_filtering_bound_logger(LEVELS.get(level, 20)),
        )
        self._allowances = {kind: _Allowance() for kind in ("client", "error", "other")}

    def say(self, level: str, event: str, now: float, **fields: Any) -> None:
        """One line. At most `PER_SECOND` of its kind in a second of `now`; the next says how many it cost.

        What clients cause (`holder`), errors and the rest are counted apart: whoever floods the one hides
        nothing of the others.
        """
        kind = "client" if "holder" in fields else "error" if LEVELS.get(level, 20) >= _ERROR else "other"
        left_out = self._allowances[kind].take(now)
        if left_out is None:
            return
        if left_out:
            fields = {**fields, "lines_left_out": left_out}
        self._logger.log(LEVELS.get(level, 20), event, **fields)

    def close(self) -> None:
        """Write what waits."""
        self._writer.close()


class _Allowance:
    """`PER_SECOND` lines in a second."""

    def __init__(self) -> None:
        self._second, self._count, self._left_out = 0.0, 0, 0

    def take(self, now: float) -> int | None:
        """How many lines went before this one without being said; None: this one is not said either."""
        if now - self._second >= 1.0:
            self._second, self._count = now, 0
        self._count += 1
        if self._count > PER_SECOND:
            self._left_out += 1
            return None
        left_out, self._left_out = self._left_out, 0
        return left_out


def at_journal(fd: int) -> bool:
    """The journal is at the other end of `fd` (JOURNAL_STREAM=device:inode, systemd.exec(5))."""
    device, _, inode = os.environ.get("JOURNAL_STREAM", "").partition(":")
    try:
        there = os.fstat(fd)
    except OSError:
        return False
    return (device, inode) == (str(there.st_dev), str(there.st_ino))


class _Sink:
    """What structlog logs to: every level is a line."""

    def __init__(self, writer: Writer) -> None:
        self.debug = self.info = self.warning = self.error = self.critical = writer.put


def _escaped(_logger: Any, _method: str, fields: Fields) -> Fields:
    """No control character, line break or text direction of a client's reaches a terminal or the journal."""
    return {key: printable(value) if isinstance(value, str) else value for key, value in fields.items()}


def printable(text: str) -> str:
    """The text with what is no visible character or space written as an escape."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def _for_journal(_logger: Any, _method: str, fields: Fields) -> str:
    return f"<{_PREFIX.get(fields['level'], 6)}>" + json.dumps(fields, ensure_ascii=False, default=str)


def _for_people(_logger: Any, _method: str, fields: Fields) -> str:
    head = f"{fields.pop('at')} {fields.pop('level'):<7} {fields.pop('event')}"
    message = fields.pop("message", None)
    tail = "".join(f" {key}={_value(value)}" for key, value in fields.items() if value is not None)
    return f"{head}: {message}{tail}" if message else head + tail


def _value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    return repr(value) if isinstance(value, str) and " " in value else str(value)
