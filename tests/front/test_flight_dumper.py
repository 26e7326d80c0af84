"""Flight files: written at a fault with its aftermath, on request, and when the loop is gone."""

import asyncio
import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.support.loop_stand_in import briefing, overview, tick
from twind import link
from twind.briefing import fingerprint
from twind.exceptions import InvalidInput
from twind.flight import EntryKind, FlightRing, copy, load
from twind.front import flight_dumper as module
from twind.front.flight_dumper import AFTERMATH, AGAIN, WRECK_AGAIN, FlightDumper, RecorderHandover
from twind.front.flight_folder import FlightFolder
from twind.front.state_cache import StateCache


class Call:
    """One call and its answers."""

    def __init__(self, **parameters: Any) -> None:
        self.parameters = parameters
        self.answers = list[Any]()

    def reply(self, parameters: bytes) -> None:
        self.answers.append(parameters)

    def error(self, name: str, parameters: Any) -> None:
        self.answers.append(name)

    def invalid(self, parameter: str, reason: str) -> None:
        self.answers.append(f"invalid {parameter}")


class Front:
    """Stand-in of a front with a flight dumper, an event loop of its own and a clock that tests move."""

    def __init__(self, handover: RecorderHandover | None) -> None:
        self.loop = asyncio.new_event_loop()
        self.world = StateCache(briefing(2))
        self.world.take(tick(1.0, 1, 2))
        self.world.take(overview(1.0, 1, 2))
        self.lines = list[tuple[str, str]]()
        self.log = SimpleNamespace(write=lambda level, event, *_, **__: self.lines.append((level, event)))
        self.owed = list[Any]()
        self.link = SimpleNamespace(owe=self.owed.append)
        self.time = 100.0
        self.handover = handover
        self.flights = FlightDumper(self, handover)  # type: ignore[arg-type]

    def now(self) -> float:
        return self.time

    def event(self, code: str, level: str = "info", time: float = 50.0) -> None:
        self.flights.event(link.Event(time=time, sequence=1, level=level, code=code, message=""))

    def housekeep(self, later: float = 0.0) -> None:
        """One round of housekeeping `later` s from now, and all writing that it starts."""
        self.time += later
        self.flights.housekeep(self.time)
        self.settle()

    def settle(self) -> None:
        """Wait until the thread has nothing to do and its results are reported."""
        threads[-1].submit(int).result()
        self.loop.run_until_complete(asyncio.sleep(0))

    def dump(self, **parameters: Any) -> Call:
        call = Call(**parameters)
        self.flights.dump(call)  # type: ignore[arg-type]
        return call

    def end(self) -> None:
        self.loop.run_until_complete(self.flights.end())
        self.loop.close()


threads: list[ThreadPoolExecutor] = []
Start = Callable[..., Front]


@pytest.fixture
def ring() -> Iterator[FlightRing]:
    ring = FlightRing.create(1 << 20)
    ring.append(EntryKind.NEWS, 255, 1.0, b"news")
    yield ring
    ring.close()


@pytest.fixture
def start(ring: FlightRing, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Start]:
    """Start a front with descriptors of its own: of the ring, and of `recording`."""

    def pool(*arguments: Any) -> ThreadPoolExecutor:
        threads.append(ThreadPoolExecutor(*arguments))
        return threads[-1]

    def begin(folder: Path = tmp_path, recording: int | None = None) -> Front:
        kept = None if recording is None else os.dup(recording)
        fronts.append(Front(RecorderHandover(folder, os.dup(ring.fd), kept)))
        return fronts[-1]

    fronts: list[Front] = []
    monkeypatch.setattr(module, "ThreadPoolExecutor", pool)
    yield begin
    monkeypatch.undo()
    for front in fronts:
        if not front.loop.is_closed():
            front.event("END")
            front.end()
    threads.clear()


@pytest.fixture
def front(start: Start) -> Front:
    return start()


def names(folder: Path) -> list[str]:
    return sorted(path.name[24:-7] for path in folder.glob("flight-*.flight"))


def no_space(_fd: int) -> None:
    raise OSError(28, "No space left on device")


@pytest.mark.parametrize("state", ["fault", "inhibited", "estop"])
def test_a_fault_is_written_with_its_aftermath_and_named_by_the_latched_code(
    front: Front, ring: FlightRing, tmp_path: Path, state: str
) -> None:
    front.event("LATENCY_WARN", "warning", 49.0)
    for code in ("BUS_ERRORS", "STATE_STALE", "LOOP_LATE"):
        front.event(code, "warning")
    front.event(state)
    front.housekeep()
    front.housekeep(AFTERMATH - 0.01)
    assert names(tmp_path) == []
    ring.append(EntryKind.NEWS, 255, 2.0, b"aftermath")
    front.housekeep(0.02)
    assert names(tmp_path) == ["STATE_STALE"]
    found = load(next(tmp_path.iterdir()))
    assert (found.meta["reason"], found.meta["mode"], found.meta["state"]) == (state, "live", "armed")
    assert [each.data for each in found.contents.entries] == [b"news", b"aftermath"]
    assert front.world.flight is not None and front.world.flight["last"].endswith("STATE_STALE.flight")
    assert front.lines == [("info", "FLIGHT_WRITTEN")]


def test_faults_in_quick_succession_share_a_file_and_each_is_written(front: Front, tmp_path: Path) -> None:
    written = []
    for step in range(300):  # a fault each 0.5 s for half a minute, rounds of 0.1 s
        if step % 5 == 0:
            front.event("fault", time=float(step))
        front.housekeep(0.1)
        written.append(len(names(tmp_path)))
    assert written[round(AFTERMATH / 0.1) + 1] == 1
    assert written[-1] == 1 + int((30.0 - AFTERMATH) / AGAIN)
    front.end()
    assert len(names(tmp_path)) == written[-1] + 1  # the end does not wait for the last aftermath


@pytest.mark.parametrize("code", ["connected", "END", "BUS_ERRORS", "NOTE"])
def test_an_event_that_needs_no_acknowledgement_writes_no_file(
    front: Front, tmp_path: Path, code: str
) -> None:
    front.event(code, "error")
    front.event("END")
    front.housekeep(60.0)
    front.end()
    assert names(tmp_path) == []


@pytest.mark.parametrize(
    "name", ["", "../x", "a b", "x" * 65, "ä", "a/b", "a.b", "CRASH", "FAILSAFE"]
)  # the last two name the daemon's own files
def test_a_dump_with_an_invalid_name_is_refused(front: Front, name: str) -> None:
    assert front.dump(name=name).answers == ["invalid name"]


def test_a_dump_is_answered_with_its_path_and_a_second_one_meanwhile_is_refused(
    start: Start, tmp_path: Path
) -> None:
    front = start(tmp_path / "new")
    first = front.dump(name="wob_1-b")
    assert front.dump().answers == ["Busy"]
    front.settle()
    front.dump()
    front.settle()
    (path,) = first.answers
    assert path == b'{"path":"%s"}' % os.fsencode(next((tmp_path / "new").glob("*wob_1-b.flight")))
    assert names(tmp_path / "new") == ["DUMP", "wob_1-b"]


def test_without_a_recorder_a_dump_is_refused_and_the_status_has_no_flight() -> None:
    front = Front(None)
    assert front.dump().answers == ["NotWritten"]
    front.event("fault")
    front.time += 60.0
    front.flights.housekeep(front.time)
    front.end()
    assert front.world.flight is None


def test_a_full_disk_is_logged_and_counted_and_the_next_dump_works(
    front: Front, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as disk:
        disk.setattr(os, "fsync", no_space)
        call = front.dump()
        front.settle()
        front.event("fault")
        front.housekeep(60.0)
    assert call.answers == ["NotWritten"]
    assert front.lines == [("error", "FLIGHT_NOT_WRITTEN")] * 2
    assert front.flights.failed == 2
    front.dump()
    front.settle()
    assert names(tmp_path) == ["DUMP"]


@pytest.mark.parametrize(
    ("farewell", "orphaned", "found"), [(True, True, []), (False, False, []), (False, True, ["CRASH"])]
)
def test_only_a_loop_that_died_without_an_end_event_has_crashed(
    front: Front,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    farewell: bool,
    orphaned: bool,
    found: list[str],
) -> None:
    monkeypatch.setattr(module, "ORPHANED", 0.0)
    if farewell:
        front.event("END")
    if orphaned:
        monkeypatch.setattr(os, "getppid", lambda: 1)
    front.end()
    assert names(tmp_path) == found


def test_the_recorder_of_a_dead_daemon_is_written_at_once_and_released(
    start: Start, ring: FlightRing, tmp_path: Path
) -> None:
    front = start(recording=ring.fd)
    assert front.owed == []  # it is kept until it is written
    front.settle()
    assert front.owed == [link.CrashRecordingDone()]
    front.event("END")
    front.end()
    assert names(tmp_path) == ["CRASH"]
    meta = load(next(tmp_path.iterdir())).meta
    assert (meta["reason"], meta["state"], meta["files"]) == ("crash", None, "unknown")
    assert front.handover is not None
    for fd in (front.handover.ring, front.handover.wreck):
        assert fd is not None
        with pytest.raises(OSError, match="Bad file"):
            os.fstat(fd)


@pytest.mark.parametrize(("version", "files"), [("", "same"), ("0.0.9", "other")])
def test_a_flight_file_states_whether_its_files_match_the_briefing(
    start: Start, ring: FlightRing, tmp_path: Path, version: str, files: str
) -> None:
    known = briefing(2)
    ring.sign(fingerprint(version or known.version, known.files))
    start(recording=ring.fd).settle()
    assert load(next(tmp_path.iterdir())).meta["files"] == files


def test_a_crash_recording_already_written_is_released_too(
    start: Start, ring: FlightRing, tmp_path: Path
) -> None:
    for _ in range(2):
        front = start(recording=ring.fd)
        front.settle()
        assert front.owed == [link.CrashRecordingDone()]
    assert front.lines == [("info", "FLIGHT_LEFT_OUT")]
    assert names(tmp_path) == ["CRASH"]


@pytest.mark.parametrize("mended", [True, False])
def test_a_crash_that_cannot_be_written_is_kept_and_tried_once_more(
    start: Start, ring: FlightRing, tmp_path: Path, mended: bool
) -> None:
    folder = tmp_path / "flight"
    folder.write_text("no folder")
    front = start(folder, ring.fd)
    front.settle()
    assert front.lines == [("error", "FLIGHT_NOT_WRITTEN")]
    front.housekeep(WRECK_AGAIN - 0.1)
    assert (len(front.lines), front.owed) == (1, [])
    if mended:
        folder.unlink()
    for later in (0.2, WRECK_AGAIN, WRECK_AGAIN):
        front.housekeep(later)
    assert front.owed == [link.CrashRecordingDone()]
    assert front.lines[1:] == [("info", "FLIGHT_WRITTEN") if mended else ("error", "FLIGHT_NOT_WRITTEN")]


def test_an_invalid_crash_recording_is_logged(start: Start) -> None:
    foreign = os.memfd_create("foreign")
    front = start(recording=foreign)
    front.settle()
    assert front.lines == [("error", "FLIGHT_NOT_WRITTEN")]
    os.close(foreign)


def test_each_dump_is_answered_even_if_the_folder_omits_the_file(
    front: Front, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(FlightFolder, "write", lambda *_: None)
    for _ in range(2):
        call = front.dump()
        front.settle()
        assert call.answers == ["NotWritten"]


def test_a_failed_thread_start_is_reported_and_the_next_dump_works(
    front: Front, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(_thread: Any) -> None:
        raise RuntimeError("can't start new thread")

    with monkeypatch.context() as threadless:
        threadless.setattr(threading.Thread, "start", none)
        assert front.dump().answers == ["NotWritten"]
        front.event("fault")
        front.time += 60.0
        front.flights.housekeep(front.time)
    assert front.lines == [("error", "FLIGHT_NOT_WRITTEN")] * 2
    assert front.world.flight is not None  # the rest of the round is done
    again = front.dump()
    front.settle()
    assert names(tmp_path) == ["DUMP"]  # the failed ones are not written later
    assert len(again.answers) == 1


def test_the_packing_thread_has_the_priority_of_the_front_since_both_share_one_interpreter(
    front: Front, monkeypatch: pytest.MonkeyPatch
) -> None:
    found: list[int] = []

    def look(fd: int) -> Any:
        found.append(os.getpriority(os.PRIO_PROCESS, threading.get_native_id()))
        return copy(fd)

    monkeypatch.setattr(module, "copy", look)
    front.dump()
    front.settle()
    assert found == [os.getpriority(os.PRIO_PROCESS, 0)]


@pytest.mark.parametrize("broken", [(float("nan"), 7), None])
def test_an_unreadable_ring_span_does_not_stop_the_housekeeping(
    front: Front, monkeypatch: pytest.MonkeyPatch, broken: Any
) -> None:
    def span(_fd: int) -> Any:
        if broken is None:
            raise InvalidInput("is none", where="ring")
        return broken

    monkeypatch.setattr(module, "held_span", span)
    front.housekeep()
    assert front.world.flight is not None
    assert front.world.flight["span_s"] == 0.0


def test_the_status_shows_the_span_and_size_of_the_recorder(front: Front) -> None:
    front.time = 31.0
    front.housekeep()
    assert front.world.flight == {"span_s": 30.0, "bytes": 16 + 4, "last": None}
