"""Messages on disk until they have arrived: SQLite, in the order of their sequence numbers.

A number is given once: AUTOINCREMENT never gives one again, and what is appended is synced
(`synchronous=FULL`) before it is sent, so that neither SIGKILL nor a power cut brings a key back for
other data. That sync is 10 ms of waiting for this thread alone, three times a second. Deletions are not
synced: one that is lost has its message sent again, under the same key.
"""

import fcntl
import json
import os
import sqlite3
import threading
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any

from twind.exceptions import OperationFailed
from twind.learn.streaming.stream_samples import PostMessage

FILE = "spool.sqlite"
LOCK = "lock"
BROKEN = "spool.sqlite.broken"
# `reason`: of a dead letter. `run`, `made`: which run of ours wrote it, at which monotonic time of that run.
SCHEMA = """
CREATE TABLE IF NOT EXISTS message (
    sequence INTEGER PRIMARY KEY AUTOINCREMENT, run INTEGER NOT NULL, made REAL NOT NULL, wall REAL NOT NULL,
    headers TEXT NOT NULL, samples INTEGER NOT NULL, reason TEXT, body BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS tally (stream TEXT NOT NULL, run INTEGER NOT NULL, sent INTEGER NOT NULL,
    dropped INTEGER NOT NULL);
"""
# What `_is_ours` looks at: texts as bytes, since a text may be none, and of the body its type alone.
LOOKED_AT = (
    "sequence, run, made, wall, typeof(headers), CAST(headers AS BLOB), samples, typeof(reason), "
    "CAST(reason AS BLOB), typeof(body)"
)
LAST = 1 << 62  # of sequence numbers and runs
LATEST = 1e11  # s, of a clock
KEPT = "sequence, headers, samples, reason, wall, body"


@dataclass(frozen=True, slots=True)
class SpoolLimits:
    """Bounds of a spool, dead letters included: the oldest goes first."""

    bytes: int  # of bodies; the file is larger by a few per cent and its journal of 4 MB
    age: float  # s


@dataclass(slots=True)
class SpoolCounts:
    """Messages: all that were = sent + dropped + waiting + dead. Replaced as a whole, never changed."""

    stream: str = ""
    sent: int = 0
    dropped: int = 0
    waiting: int = 0
    dead: int = 0
    bytes: int = 0


@dataclass(frozen=True, slots=True)
class SpooledMessage:
    """A message of the spool. `wall`: when it was appended, s since 1970; `reason`: why it is dead."""

    sequence: int
    message: PostMessage
    reason: str | None
    wall: float


class Spool:
    """A folder of one process, for several threads. Each call waits for the disk and raises sqlite3.Error."""

    def __init__(self, folder: Path, bounds: SpoolLimits, now: float, wall: float) -> None:
        """Raises OperationFailed, OSError, sqlite3.Error. `set_aside`: why an older file is read no more."""
        self.folder = folder
        self._bounds = bounds
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        if (folder / FILE).is_symlink():  # SQLite would follow it
            raise OperationFailed(f"{folder / FILE}: is a symbolic link; name another folder with --spool")
        self._held = _hold(folder / LOCK)
        self._lock = threading.Lock()
        self.set_aside = ""
        self.tally = SpoolCounts()
        try:
            try:
                self._open()
            except sqlite3.DatabaseError as error:
                if isinstance(error, sqlite3.OperationalError):
                    raise  # full, or not permitted: the file itself may be good
                self.set_aside = f"a spool that cannot be read ({error}) is kept beside a new one"
                _set_aside(folder)
                self._open()
            self.expire(now, wall)
        except BaseException:
            self.close()
            raise

    def _open(self) -> None:
        self._base = sqlite3.connect(self.folder / FILE, isolation_level=None, check_same_thread=False)
        self._base.execute("PRAGMA journal_mode=WAL")
        self._base.execute("PRAGMA journal_size_limit=4194304")
        self._base.executescript(SCHEMA)
        self._require_own_tables()
        with self._all_or_nothing(synced=True):
            foreign = [
                (row[0],)
                for row in self._base.execute(f"SELECT {LOOKED_AT} FROM message")
                if not _is_ours(row)
            ]
            if foreign:
                self._base.execute("CREATE TABLE IF NOT EXISTS aside AS SELECT * FROM message WHERE 0")
                self._base.executemany("INSERT INTO aside SELECT * FROM message WHERE sequence = ?", foreign)
                self._base.executemany("DELETE FROM message WHERE sequence = ?", foreign)
                self.set_aside = f"{len(foreign)} rows that no streamer wrote are in its table `aside` now"
            if self._base.execute("SELECT 1 FROM tally").fetchone() is None:
                self._base.execute("INSERT INTO tally VALUES (?, 0, 0, 0)", (uuid.uuid4().hex[:16],))
            self._base.execute("UPDATE tally SET run = run + 1")
        self._run = int(self._fetch_one("SELECT run FROM tally"))
        dead, bodies = self._rows("SELECT count(reason), coalesce(sum(length(body)), 0) FROM message")[0]
        stream, sent, dropped = self._rows("SELECT stream, sent, dropped FROM tally")[0]
        waiting = int(self._fetch_one("SELECT count(*) FROM message WHERE reason IS NULL"))
        self.tally = SpoolCounts(stream, sent, dropped, waiting, dead, bodies)

    def _require_own_tables(self) -> None:
        """Raises sqlite3.DatabaseError: tables or counts of another program."""
        columns = {row[1] for row in self._base.execute("PRAGMA table_info(message)")}
        counts = self._rows("SELECT run, sent, dropped FROM tally")
        counts += self._rows("SELECT max(seq), 0, 0 FROM sqlite_sequence WHERE name = 'message'")
        whole = all(
            type(each) is int and 0 <= each < LAST for row in counts for each in row if each is not None
        )
        names = all(type(name) is str for (name,) in self._rows("SELECT stream FROM tally"))
        if not (whole and names) or columns != {"made", "run", *KEPT.split(", ")}:
            raise sqlite3.DatabaseError("its tables are not those of a spool")

    def __enter__(self) -> "Spool":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the folder."""
        if hasattr(self, "_base"):
            self._base.close()
        os.close(self._held)

    # ------------------------------------------------------------------------------------------ in and out

    def append(self, message: PostMessage, now: float, wall: float, lost: int = 0) -> int:
        """Its sequence number, once it is on the disk. `lost`: messages before it that never got here."""
        row = (self._run, now, wall, json.dumps(dict(message.headers)), message.samples, message.body)
        with self._lock, self._all_or_nothing(synced=True) as changed:
            found = self._base.execute(
                "INSERT INTO message (run, made, wall, headers, samples, body) VALUES (?, ?, ?, ?, ?, ?)", row
            )
            changed.waiting += 1
            changed.bytes += len(message.body)
            changed.dropped += lost
            self._drop_old(changed, now, wall)
        assert found.lastrowid is not None
        return found.lastrowid

    def oldest(self, after: int = 0) -> SpooledMessage | None:
        """The first that waits behind sequence number `after`."""
        with self._lock:
            found = self._base.execute(
                f"SELECT {KEPT} FROM message WHERE sequence > ? AND reason IS NULL ORDER BY sequence LIMIT 1",
                (after,),
            ).fetchone()
        return None if found is None else _decode_row(found)

    def acknowledge(self, sequence: int) -> None:
        """It arrived. One that was dropped meanwhile stays counted as dropped."""
        with self._lock, self._all_or_nothing() as changed:
            changed.sent += self._take_away(changed, sequence)

    def bury(self, sequence: int, reason: str) -> None:
        """It will never be taken: a dead letter, kept within the same bounds."""
        with self._lock, self._all_or_nothing() as changed:
            done = self._base.execute(
                "UPDATE message SET reason = ? WHERE sequence = ? AND reason IS NULL", (reason, sequence)
            )
            changed.waiting -= done.rowcount
            changed.dead += done.rowcount

    def revive(self) -> int:
        """Dead letters wait again, in their old places; how many."""
        with self._lock, self._all_or_nothing() as changed:
            count = self._base.execute("UPDATE message SET reason = NULL WHERE reason IS NOT NULL").rowcount
            changed.waiting += count
            changed.dead -= count
        return count

    def expire(self, now: float, wall: float, lost: int = 0) -> None:
        """Drop messages that have become too old or too many. `lost` as in `append`."""
        with self._lock, self._all_or_nothing() as changed:
            changed.dropped += lost
            self._drop_old(changed, now, wall)

    # ------------------------------------------------------------------------------------------ inside

    def _drop_old(self, changed: SpoolCounts, now: float, wall: float) -> None:
        """Drop the messages that exceed the age or the size bounds, the oldest first.

        The age of messages of this run is measured by the monotonic clock, so that a step of the wall clock
        drops none of them.
        """
        while True:
            first = self._rows("SELECT sequence, run, made, wall FROM message ORDER BY sequence LIMIT 1")
            if not first:
                return
            sequence, run, made, written = first[0]
            age = now - made if run == self._run else wall - written
            if age <= self._bounds.age and changed.bytes <= self._bounds.bytes:
                return
            changed.dropped += self._take_away(changed, sequence)

    def _take_away(self, changed: SpoolCounts, sequence: int) -> bool:
        """Delete one message; return whether it was there."""
        found = self._rows("SELECT length(body), reason IS NULL FROM message WHERE sequence = ?", (sequence,))
        if not found:
            return False
        self._base.execute("DELETE FROM message WHERE sequence = ?", (sequence,))
        size, waiting = found[0]
        changed.bytes -= size
        changed.waiting -= waiting
        changed.dead -= 1 - waiting
        return True

    @contextmanager
    def _all_or_nothing(self, *, synced: bool = False) -> Iterator[SpoolCounts]:
        """A transaction, and the tally after it; where it fails all is as it was."""
        self._base.execute(f"PRAGMA synchronous={'FULL' if synced else 'NORMAL'}")
        was = self.tally
        changed = replace(self.tally)
        self._base.execute("BEGIN IMMEDIATE")
        try:
            yield changed
            if (changed.sent, changed.dropped) != (was.sent, was.dropped):
                self._base.execute("UPDATE tally SET sent = ?, dropped = ?", (changed.sent, changed.dropped))
            self._base.execute("COMMIT")
        except BaseException:
            if self._base.in_transaction:
                self._base.execute("ROLLBACK")
            raise
        self.tally = changed

    def _rows(self, query: str, values: tuple[object, ...] = ()) -> list[Any]:
        return self._base.execute(query, values).fetchall()

    def _fetch_one(self, query: str) -> Any:
        return self._base.execute(query).fetchone()[0]


def dead_letters(folder: Path) -> list[SpooledMessage]:
    """Return the dead letters of a spool, also of one in use. Raises sqlite3.Error where there is none."""
    base = sqlite3.connect(f"{(folder / FILE).absolute().as_uri()}?mode=ro", uri=True)
    try:
        looked_at = base.execute(
            f"SELECT {LOOKED_AT} FROM message WHERE reason IS NOT NULL ORDER BY sequence"
        )
        numbers = [row[0] for row in looked_at if _is_ours(row)]
        one = f"SELECT {KEPT} FROM message WHERE sequence = ?"
        return [_decode_row(row) for number in numbers for row in base.execute(one, (number,))]
    finally:
        base.close()


def _is_ours(row: tuple[Any, ...]) -> bool:
    """Return whether a streamer can have written a row, given as LOOKED_AT."""
    sequence, run, made, wall, is_text, headers, samples, has_reason, reason, is_body = row
    if not all(type(each) is int and 0 <= each < LAST for each in (sequence, run, samples)):
        return False
    if not all(type(each) is float and abs(each) <= LATEST for each in (made, wall)):
        return False
    if (is_text, is_body) != ("text", "blob") or has_reason not in ("text", "null"):
        return False
    try:
        found = json.loads(headers.decode())
        str(reason or b"", "utf-8")
    except (ValueError, RecursionError):
        return False
    return isinstance(found, dict) and all(isinstance(each, str) for each in found.values())


def _decode_row(row: tuple[int, str, int, str | None, float, bytes]) -> SpooledMessage:
    sequence, headers, samples, reason, wall, body = row
    return SpooledMessage(sequence, PostMessage(body, json.loads(headers), samples), reason, wall)


def _hold(path: Path) -> int:
    """The lock of a folder, for as long as the descriptor lives: the system frees it with the process."""
    held = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        holder = os.read(held, 32).decode(errors="replace").strip()
        os.close(held)
        raise OperationFailed(
            f"{path.parent}: process {holder or '?'} streams from it; end that, or name another with --spool"
        ) from None
    os.ftruncate(held, 0)
    os.write(held, f"{os.getpid()}\n".encode())
    return held


def _set_aside(folder: Path) -> None:
    """Keep a file that cannot be read, once. The new spool has a new name, so no key comes again."""
    (folder / FILE).replace(folder / BROKEN)
    for tail in ("-wal", "-shm"):
        (folder / (FILE + tail)).unlink(missing_ok=True)
