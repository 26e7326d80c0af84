"""Writer of recordings: a thread with a bounded queue, so that a slow disk costs messages and nothing else.

Messages that find no room are dropped and counted. A file ends at its size, at its hour, or with its
episode; the bounds of the disk are checked with every flush.
"""

import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

from twind.client.clock_pair import ClockPair
from twind.new_file import unwritten
from twind.observe.recording.recording_topics import (
    COMMANDS,
    END,
    EPISODE,
    INERTIAL,
    JOINTS,
    LATENCY,
    MEASURED,
    SIMULATED,
    STATUS,
)
from twind.observe.writing.record_encoder import RecordLine, note, shifted
from twind.observe.writing.record_file import RecordFile
from twind.observe.writing.record_folder import DiskQuota, free, fresh, make_room
from twind.observe.writing.record_schemas import clock_words

ROOM = 16 << 20  # bytes that may wait: a minute of a robot of 24 joints at 100 Hz
PERIODIC = frozenset({MEASURED, SIMULATED, COMMANDS, INERTIAL, JOINTS, LATENCY, STATUS})
FLUSH = 0.5  # s between two ends of a chunk: with what waits less than a second is not on the disk yet
NAP = 0.1  # s in which lines gather
TRIES = 20  # names for a file, where other recorders begin theirs in the same moment

Attachments: TypeAlias = Mapping[str, tuple[str, bytes]]
OpenFile: TypeAlias = Callable[[Path, Mapping[str, str], Attachments, int], RecordFile]


@dataclass(frozen=True, slots=True)
class RecordSession:
    """One connection to one daemon: the metadata and attachments at the head of its files, and its clocks."""

    robot: str
    clocks: ClockPair
    about: Mapping[str, str]
    attachments: Attachments
    why: str = "a new connection"  # the file before it ends


@dataclass(frozen=True, slots=True)
class OpenEpisode:
    """An episode that is open. `begin` in ns since 1970."""

    task: str
    begin: int


@dataclass(frozen=True, slots=True)
class RecordCounts:
    """Counts of what was written so far."""

    path: Path | None = None  # the file that is open
    files: tuple[Path, ...] = ()  # all of them
    messages: int = 0
    bytes: int = 0
    dropped: int = 0  # here: the queue was full
    missed: int = 0  # by the daemon: this reader was too slow for it
    removed: int = 0  # old recordings
    episode: OpenEpisode | None = None
    episodes: int = 0


class RecordWriter:
    """Writer of lines from any thread. It writes nothing after `close`, or once `stopped` has a reason."""

    def __init__(
        self,
        place: Path,
        bounds: DiskQuota,
        now: Callable[[], float],
        *,
        per_episode: bool = False,
        clocks: Callable[[], ClockPair] | None = None,
        open_file: OpenFile = RecordFile,
    ) -> None:
        """`place`: a folder, or an .mcap file. `now`: monotonic, s.

        `clocks` are read when a file begins, so that the next is right after the wall clock was set; None:
        those of the session hold.
        """
        single = place.suffix == ".mcap"
        self.folder = place.parent if single else place
        self._single = place if single else None
        self.quota = bounds
        self._now = now
        self._per_episode = per_episode
        self._open_file = open_file
        self.stopped = ""
        self.tally = RecordCounts()
        self._lock = threading.Lock()
        self._queue: deque[RecordLine | RecordSession | None] = deque()
        self._waiting = self._dropped = self._missed = self._noted = 0
        self._before = (0, 0)  # dropped and missed when the last file ended
        self._closing = False
        self._session: RecordSession | None = None
        self._read_clocks = clocks
        self.clocks: ClockPair | None = None  # of the file that is open, or was last
        self._shift = 0  # ns from the session's clocks to those of the file
        self._file: RecordFile | None = None
        self._file_began = self._flushed = now()
        self._thread: threading.Thread | None = None
        self._wake = threading.Event()

    def start(self) -> None:
        """Write in a thread from now on; without it the caller of `step` writes."""
        self._thread = threading.Thread(target=self._run, name="recording", daemon=True)
        self._thread.start()

    def put(self, line: RecordLine) -> bool:
        """Hand over one message; False: there was no room. What is rare has twice the room."""
        room = ROOM if line.topic in PERIODIC else 2 * ROOM
        with self._lock:
            if self._waiting + len(line.data) > room:
                self._dropped += 1
                return False
            self._waiting += len(line.data)
            self._queue.append(line)
        return True

    def missed(self, count: int) -> None:
        """The daemon dropped so many messages that were meant for us."""
        with self._lock:
            self._missed += count

    def begin(self, session: RecordSession) -> None:
        """Begin a new file: the following messages are of another connection."""
        self._report_item(session)

    def end(self) -> None:
        """The connection is gone: the file is finished."""
        self._report_item(None)

    def close(self, patience: float = 30.0) -> bool:
        """Write all that waits and finish the file; False: the disk did not take it within `patience` s."""
        self._closing = True
        self._wake.set()
        if self._thread is None:
            self.step(last=True)
            return True
        self._thread.join(patience)
        return not self._thread.is_alive()

    def step(self, *, last: bool = False) -> None:
        """Write what waits, end the chunk when it is time; `last`: finish the file."""
        try:
            while self._drain():
                self._upkeep()
            self._upkeep()
            if last:
                self._finish("stopped")
                self._session = None
        except OSError as error:
            self.stopped = f"{self.tally.path or self.folder}: {unwritten(error)}"
            if self._file is not None:
                self._abandon(self._file)

    def _abandon(self, file: RecordFile) -> None:
        lost = file.abandon()
        with self._lock:
            self._dropped += lost
        self._count()
        self.tally = replace(self.tally, messages=self.tally.messages - lost)
        self._file = None

    def _report_item(self, item: RecordSession | None) -> None:
        with self._lock:
            self._queue.append(item)
        self._wake.set()

    # ------------------------------------------------------------------------------------------ the thread

    def _run(self) -> None:
        last = False
        try:
            while not last:
                self._wake.wait(NAP)
                self._wake.clear()
                last = self._closing  # what is put from now on need not be written
                self.step(last=last)
        finally:
            if not last:
                self.stopped = self.stopped or "the writer failed, which is an error of twind; see above"

    def _drain(self) -> bool:
        """Write what waits; True: there is more, but a chunk is to end first."""
        while not self._due():
            with self._lock:
                if not self._queue:
                    break
                item = self._queue.popleft()
                self._waiting -= len(item.data) if isinstance(item, RecordLine) else 0
            if isinstance(item, RecordLine):
                self._take(item)
            else:
                self._finish("the daemon is gone" if item is None else item.why)
                self._session = item
        self._count()
        return self._due()

    def _due(self) -> bool:
        return self._file is not None and self._now() - self._flushed >= FLUSH

    def _count(self) -> None:
        with self._lock:
            self.tally = replace(self.tally, dropped=self._dropped, missed=self._missed)

    def _take(self, line: RecordLine) -> None:
        kind = line.mark.get("kind") if line.mark is not None else None
        if self._session is not None and not self.stopped:
            # an episode that is open goes on in the next file, where its own ended before it
            wanted = kind == "begin" or not self._per_episode or self.tally.episode is not None
            if self._file is None and wanted:
                self._start(self._session, line)
            if self._file is not None:
                self._write(self._file, line)
                return
        if kind == "end":
            self.tally = replace(self.tally, episode=None)

    def _write(self, file: RecordFile, line: RecordLine) -> None:
        line = shifted(line, self._shift) if self._shift else line
        file.write(line.topic, line.time_ns, line.data)
        self.tally = replace(self.tally, messages=self.tally.messages + 1)
        if line.mark is not None and line.mark.get("kind") in ("begin", "end"):
            self._marked(line.mark, line.time_ns, file)

    def _start(self, session: RecordSession, line: RecordLine) -> None:
        clocks = session.clocks if self._read_clocks is None else self._read_clocks()
        self._shift = session.clocks.step(clocks)
        self.clocks = clocks if self._shift else session.clocks
        began = line.time_ns + self._shift
        name = session.robot
        if self._per_episode:
            name = f"{name}-{self._task(line) or 'episode'}"
        self._make_room()
        if self.stopped:
            return
        about = {**session.about, **clock_words(self.clocks)}
        for left in reversed(range(TRIES)):
            path = fresh(self.folder, began, name) if self._single is None else _next(self._single)
            try:
                self._file = self._open_file(path, about, session.attachments, began)
                break
            except FileExistsError:  # another recorder has taken this name meanwhile
                if not left:
                    raise
        assert self._file is not None
        self._file_began = self._flushed = self._now()
        self.tally = replace(self.tally, path=path, files=(*self.tally.files, path), bytes=self._file.size)

    def _task(self, line: RecordLine) -> str:
        """Return the task of the episode that a file belongs to; `line` is the first message of the file."""
        if line.mark is not None and line.mark.get("kind") == "begin":
            return str(line.mark.get("task") or "")
        return self.tally.episode.task if self.tally.episode is not None else ""

    def _marked(self, mark: Mapping[str, str | bool | None], time_ns: int, file: RecordFile) -> None:
        if self.tally.episode is not None:
            self._write_episode(file, str(time_ns), mark if mark["kind"] == "end" else {})
        elif mark["kind"] == "end":  # it began before this recording
            self.tally = replace(self.tally, episode=OpenEpisode(str(mark.get("task") or ""), 0))
            self._write_episode(file, str(time_ns), mark)
        begun = OpenEpisode(str(mark.get("task") or ""), time_ns) if mark["kind"] == "begin" else None
        self.tally = replace(self.tally, episode=begun)
        if begun is None and self._per_episode:
            self._finish("the episode ended")

    def _write_episode(self, file: RecordFile, end: str, mark: Mapping[str, str | bool | None]) -> None:
        episode = self.tally.episode
        success = mark.get("success")
        assert episode is not None
        said = "" if success is None else str(bool(success)).lower()
        begin = str(episode.begin or "")
        file.metadata(EPISODE, {"task": episode.task, "success": said, "begin": begin, "end": end})
        self.tally = replace(self.tally, episodes=self.tally.episodes + bool(end))

    def _upkeep(self) -> None:
        """Twice a second: note the losses, end the chunk, and keep the bounds of the disk."""
        file = self._file
        if file is None or not self._due():
            return
        self._note_losses(file)
        file.flush()
        self._flushed = self._now()
        self.tally = replace(self.tally, bytes=file.size)
        old = self._now() - self._file_began >= self.quota.longest
        if old or file.size >= self.quota.largest:
            self._finish("an hour" if old else "its size")
        else:
            self._make_room()
            if self.stopped:
                self._finish(self.stopped)

    def _note_losses(self, file: RecordFile) -> None:
        self._count()
        lost = self.tally.dropped + self.tally.missed
        if self._session is not None and lost > self._noted:
            line = note(self._session.clocks, self._now(), "dropped", count=lost - self._noted)
            file.write(line.topic, line.time_ns + self._shift, line.data)
            self._noted = lost

    def _make_room(self) -> None:
        """Remove old recordings; set `stopped` if the disk is too full all the same."""
        if self._single is None:
            gone = make_room(self.folder, self.quota.keep, self.tally.path, self.tally.files)
            self.tally = replace(self.tally, removed=self.tally.removed + len(gone))
        left = free(self.folder)
        if left < self.quota.free:
            self.stopped = (
                f"{self.folder}: {left >> 20} MiB are free, {self.quota.free >> 20} MiB are to stay so; "
                "make room, or allow less with --free"
            )

    def _finish(self, reason: str) -> None:
        file = self._file
        if file is None:
            return
        self._note_losses(file)
        if self.tally.episode is not None:
            self._write_episode(file, "", {})
        dropped = self.tally.dropped - self._before[0]
        missed = self.tally.missed - self._before[1]
        self._before = self.tally.dropped, self.tally.missed
        lost = {"dropped": str(dropped), "dropped_by_daemon": str(missed)}
        file.metadata(END, {"reason": reason, "messages": str(file.messages), **lost})
        file.finish()
        self._file = None
        self.tally = replace(self.tally, bytes=file.size, path=None)


def _next(path: Path) -> Path:
    """The path itself, or the next that nothing stands at: `run.mcap`, `run.2.mcap`."""
    if not path.exists():
        return path
    return next(
        found for more in range(2, 1 << 20) if not (found := path.with_suffix(f".{more}.mcap")).exists()
    )
