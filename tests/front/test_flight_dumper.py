"""When a flight file is written: at a fault, with what followed, when asked, and when the loop is gone."""

import asyncio
import os
import threading
from collections.abc import Callable, Coroutine, Iterator
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


@pytest.fixture
def ring() -> Iterator[FlightRing]:
    ring = FlightRing.create(1 << 20)
    ring.append(EntryKind.NEWS, 255, 1.0, b"news")
    yield ring
    ring.close()


def recorded(folder: Path, ring: FlightRing | int, wreck: FlightRing | int | None = None) -> RecorderHandover:
    """As a front is handed them: descriptors of its own."""
    fds = [None if one is None else os.dup(one if isinstance(one, int) else one.fd) for one in (ring, wreck)]
    return RecorderHandover(folder, *fds)


class Front:
    """As much of a front as there needs to be; its time is ours."""

    def __init__(self) -> None:
        self.loop = asyncio.get_running_loop()
        self.world = StateCache(briefing(2))
        self.world.take(tick(1.0, 1, 2))
        self.world.take(overview(1.0, 1, 2))
        self.log = SimpleNamespace(write=self._say)
        self.lines = list[tuple[str, str]]()
        self.link = SimpleNamespace(owe=self._owe)
        self.owed = list[Any]()
        self.time = 100.0

    def _owe(self, command: Any) -> None:
        self.owed.append(command)

    def now(self) -> float:
        return self.time

    def _say(self, level: str, event: str, now: float, **fields: Any) -> None:
        self.lines.append((level, event))


class Call:
    """One call, and what it was answered."""

    def __init__(self, **parameters: Any) -> None:
        self.parameters = parameters
        self.answers = list[Any]()

    def reply(self, parameters: bytes) -> None:
        self.answers.append(parameters)

    def error(self, name: str, parameters: Any) -> None:
        self.answers.append(name)

    def invalid(self, parameter: str, reason: str) -> None:
        self.answers.append(f"invalid {parameter}")


def event(code: str, level: str = "info", time: float = 50.0) -> link.Event:
    return link.Event(time=time, sequence=1, level=level, code=code, message="")


def run(story: Callable[[], Coroutine[Any, Any, None]]) -> None:
    asyncio.run(story())


async def settled(flights: FlightDumper) -> None:
    """Until the thread has nothing to do, and what it did is told."""
    await asyncio.get_running_loop().run_in_executor(None, flights._thread.submit(int).result)
    await asyncio.sleep(0)


def names(folder: Path) -> list[str]:
    return sorted(path.name[24:-7] for path in folder.glob("flight-*.flight"))


@pytest.mark.parametrize("state", ["fault", "inhibited", "estop"])
def test_a_fault_is_written_with_what_followed_and_by_what_latched_it(
    ring: FlightRing, tmp_path: Path, state: str
) -> None:
    async def story() -> None:
        front = Front()
        flights = FlightDumper(front, recorded(tmp_path, ring))  # type: ignore[arg-type]
        flights.event(event("LATENCY_WARN", "warning", 49.0))
        for code in ("BUS_ERRORS", "STATE_STALE", "LOOP_LATE"):
            flights.event(event(code, "warning"))
        flights.event(event(state))
        flights.housekeep(front.time)
        front.time += AFTERMATH - 0.01
        flights.housekeep(front.time)
        await settled(flights)
        assert names(tmp_path) == []
        ring.append(EntryKind.NEWS, 255, 2.0, b"aftermath")
        front.time += 0.02
        flights.housekeep(front.time)
        await settled(flights)
        assert names(tmp_path) == ["STATE_STALE"]
        found = load(next(tmp_path.iterdir()))
        assert found.meta["reason"] == state
        assert (found.meta["mode"], found.meta["state"]) == ("live", "armed")
        assert [each.data for each in found.contents.entries] == [b"news", b"aftermath"]
        assert front.world.flight is not None and front.world.flight["last"].endswith("STATE_STALE.flight")
        assert front.lines == [("info", "FLIGHT_WRITTEN")]
        await flights.end()

    run(story)


def test_faults_that_follow_at_once_share_a_file_and_none_goes_unwritten(
    ring: FlightRing, tmp_path: Path
) -> None:
    async def story() -> None:
        front = Front()
        flights = FlightDumper(front, recorded(tmp_path, ring))  # type: ignore[arg-type]
        written = []
        for step in range(300):  # a fault each 0.5 s for half a minute, rounds of 0.1 s
            if step % 5 == 0:
                flights.event(event("fault", time=float(step)))
            front.time += 0.1
            flights.housekeep(front.time)
            await settled(flights)
            written.append(len(names(tmp_path)))
        assert written[round(AFTERMATH / 0.1) + 1] == 1
        assert written[-1] == 1 + int((30.0 - AFTERMATH) / AGAIN)
        await flights.end()
        assert len(names(tmp_path)) == written[-1] + 1  # the last one is not waited for

    run(story)


@pytest.mark.parametrize("code", ["connected", "END", "BUS_ERRORS", "NOTE"])
def test_an_event_that_needs_no_acknowledgement_writes_no_flight_file(
    ring: FlightRing, tmp_path: Path, code: str
) -> None:
    async def story() -> None:
        front = Front()
        flights = FlightDumper(front, recorded(tmp_path, ring))  # type: ignore[arg-type]
        flights.event(event(code, "error"))
        flights.event(event("END"))
        front.time += 60.0
        flights.housekeep(front.time)
        await flights.end()
        assert names(tmp_path) == []

    run(story)


def test_a_dump_is_answered_with_its_path_and_takes_only_names_of_files(
    ring: FlightRing, tmp_path: Path
) -> None:
    async def story() -> None:
        front = Front()
        flights = FlightDumper(front, recorded(tmp_path / "new", ring))  # type: ignore[arg-type]
        for name in ("", "../x", "a b", "x" * 65, "ä", "a/b", "a.b"):
            call = Call(name=name)
            flights.dump(call)  # type: ignore[arg-type]
            assert call.answers == ["invalid name"]
        first = Call(name="wob_1-b")
        second = Call()
        third = Call()
        flights.dump(first)  # type: ignore[arg-type]
        flights.dump(second)  # type: ignore[arg-type]
        assert second.answers == ["Busy"]
        await settled(flights)
        flights.dump(third)  # type: ignore[arg-type]
        await settled(flights)
        (path,) = first.answers
        assert path == b'{"path":"%s"}' % os.fsencode(next((tmp_path / "new").glob("*wob_1-b.flight")))
        assert names(tmp_path / "new") == ["DUMP", "wob_1-b"]

    run(story)


def test_without_a_recorder_a_dump_is_refused_and_the_status_has_no_flight(tmp_path: Path) -> None:
    async def story() -> None:
        front = Front()
        flights = FlightDumper(front, None)  # type: ignore[arg-type]
        call = Call()
        flights.dump(call)  # type: ignore[arg-type]
        flights.event(event("fault"))
        front.time += 60.0
        flights.housekeep(front.time)
        await flights.end()
        assert call.answers == ["NotWritten"]
        assert front.world.flight is None

    run(story)


def test_a_disk_that_takes_nothing_costs_a_line_and_is_counted(
    ring: FlightRing, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_fd: int) -> None:
        raise OSError(28, "No space left on device")

    async def story() -> None:
        front = Front()
        flights = FlightDumper(front, recorded(tmp_path, ring))  # type: ignore[arg-type]
        monkeypatch.setattr(os, "fsync", full)
        call = Call()
        flights.dump(call)  # type: ignore[arg-type]
        await settled(flights)
        flights.event(event("fault"))
        front.time += 60.0
        flights.housekeep(front.time)
        await settled(flights)
        assert call.answers == ["NotWritten"]
        assert front.lines == [("error", "FLIGHT_NOT_WRITTEN")] * 2
        assert flights.failed == 2
        monkeypatch.undo()
        again = Call()
        flights.dump(again)  # type: ignore[arg-type]
        await settled(flights)
        assert names(tmp_path) == ["DUMP"]

    run(story)


@pytest.mark.parametrize(
    ("farewell", "orphaned", "found"), [(True, True, []), (False, False, []), (False, True, ["CRASH"])]
)
def test_only_a_loop_that_died_without_an_end_event_has_crashed(
    ring: FlightRing,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    farewell: bool,
    orphaned: bool,
    found: list[str],
) -> None:
    monkeypatch.setattr(module, "ORPHANED", 0.0)

    async def story() -> None:
        flights = FlightDumper(Front(), recorded(tmp_path, ring))  # type: ignore[arg-type]
        if farewell:
            flights.event(event("END"))
        if orphaned:
            monkeypatch.setattr(os, "getppid", lambda: 1)
        await flights.end()
        assert names(tmp_path) == found

    run(story)


def test_the_recorder_of_a_daemon_that_is_gone_is_written_at_once_and_let_go(
    ring: FlightRing, tmp_path: Path
) -> None:
    given = recorded(tmp_path, ring, ring)

    async def story() -> None:
        front = Front()
        flights = FlightDumper(front, given)  # type: ignore[arg-type]
        assert front.owed == []  # until then it is kept
        await settled(flights)
        assert front.owed == [link.CrashRecordingDone()]
        flights.event(event("END"))
        await flights.end()
        assert names(tmp_path) == ["CRASH"]
        meta = load(next(tmp_path.iterdir())).meta
        assert (meta["reason"], meta["state"], meta["files"]) == ("crash", None, "unknown")

    run(story)
    for fd in (given.ring, given.wreck):
        assert fd is not None
        with pytest.raises(OSError, match="Bad file"):
            os.fstat(fd)


@pytest.mark.parametrize(("version", "files"), [("", "same"), ("0.0.9", "other")])
def test_a_flight_file_states_whether_its_files_match_the_briefing(
    ring: FlightRing, tmp_path: Path, version: str, files: str
) -> None:
    async def story() -> None:
        front = Front()
        told = front.world.briefing
        ring.sign(fingerprint(version or told.version, told.files))
        flights = FlightDumper(front, recorded(tmp_path, ring, ring))  # type: ignore[arg-type]
        await settled(flights)
        assert load(next(tmp_path.iterdir())).meta["files"] == files
        await flights.end()

    run(story)


def test_a_crash_recording_already_written_is_released_too(ring: FlightRing, tmp_path: Path) -> None:
    async def story() -> None:
        for _ in range(2):
            front = Front()
            flights = FlightDumper(front, recorded(tmp_path, ring, ring))  # type: ignore[arg-type]
            await settled(flights)
            assert front.owed == [link.CrashRecordingDone()]
            flights.event(event("END"))
            await flights.end()
        assert front.lines == [("info", "FLIGHT_LEFT_OUT")]
        assert names(tmp_path) == ["CRASH"]

    run(story)


@pytest.mark.parametrize("mended", [True, False])
def test_a_crash_that_cannot_be_written_is_kept_and_tried_once_more(
    ring: FlightRing, tmp_path: Path, mended: bool
) -> None:
    folder = tmp_path / "flight"
    folder.write_text("no folder")

    async def story() -> None:
        front = Front()
        flights = FlightDumper(front, recorded(folder, ring, ring))  # type: ignore[arg-type]
        await settled(flights)
        assert front.lines == [("error", "FLIGHT_NOT_WRITTEN")]
        front.time += WRECK_AGAIN - 0.1
        flights.housekeep(front.time)
        await settled(flights)
        assert (len(front.lines), front.owed) == (1, [])
        if mended:
            folder.unlink()
        front.time += 0.2
        for _ in range(3):
            flights.housekeep(front.time)
            await settled(flights)
            front.time += WRECK_AGAIN
        assert front.owed == [link.CrashRecordingDone()]
        assert front.lines[1:] == [("info", "FLIGHT_WRITTEN") if mended else ("error", "FLIGHT_NOT_WRITTEN")]
        flights.event(event("END"))
        await flights.end()

    run(story)


def test_an_invalid_crash_recording_is_logged(ring: FlightRing, tmp_path: Path) -> None:
    foreign = os.memfd_create("foreign")

    async def story() -> None:
        front = Front()
        flights = FlightDumper(front, recorded(tmp_path, ring, foreign))  # type: ignore[arg-type]
        await settled(flights)
        assert front.lines == [("error", "FLIGHT_NOT_WRITTEN")]

    run(story)
    os.close(foreign)


@pytest.mark.parametrize("name", ["CRASH", "FAILSAFE"])
def test_names_of_the_daemon_s_own_files_are_not_to_be_had(
    ring: FlightRing, tmp_path: Path, name: str
) -> None:
    async def story() -> None:
        flights = FlightDumper(Front(), recorded(tmp_path, ring))  # type: ignore[arg-type]
        call = Call(name=name)
        flights.dump(call)  # type: ignore[arg-type]
        assert call.answers == ["invalid name"]

    run(story)


def test_a_dump_request_is_answered_even_if_the_folder_omits_the_file(
    ring: FlightRing, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def story() -> None:
        flights = FlightDumper(Front(), recorded(tmp_path, ring))  # type: ignore[arg-type]
        monkeypatch.setattr(FlightFolder, "write", lambda *_: None)
        for _ in range(2):
            call = Call()
            flights.dump(call)  # type: ignore[arg-type]
            await settled(flights)
            assert call.answers == ["NotWritten"]

    run(story)


def test_a_failed_thread_start_is_reported_and_the_next_dump_works(
    ring: FlightRing, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(_thread: Any) -> None:
        raise RuntimeError("can't start new thread")

    async def story() -> None:
        front = Front()
        monkeypatch.setattr(threading.Thread, "start", none)
        flights = FlightDumper(front, recorded(tmp_path, ring))  # type: ignore[arg-type]
        call = Call()
        again = Call()
        flights.dump(call)  # type: ignore[arg-type]
        assert call.answers == ["NotWritten"]
        flights.event(event("fault"))
        front.time += 60.0
        flights.housekeep(front.time)
        assert front.lines == [("error", "FLIGHT_NOT_WRITTEN")] * 2
        assert front.world.flight is not None  # the rest of the round is done
        monkeypatch.undo()
        flights.dump(again)  # type: ignore[arg-type]
        await settled(flights)
        assert names(tmp_path) == ["DUMP"]  # and nothing of what was told as lost
        assert len(again.answers) == 1

    run(story)


def test_the_thread_that_packs_is_as_urgent_as_the_front_since_both_share_one_interpreter(
    ring: FlightRing, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found: list[int] = []

    def look(fd: int) -> Any:
        found.append(os.getpriority(os.PRIO_PROCESS, threading.get_native_id()))
        return copy(fd)

    async def story() -> None:
        monkeypatch.setattr(module, "copy", look)
        flights = FlightDumper(Front(), recorded(tmp_path, ring))  # type: ignore[arg-type]
        flights.dump(Call())  # type: ignore[arg-type]
        await settled(flights)

    run(story)
    assert found == [os.getpriority(os.PRIO_PROCESS, 0)]


@pytest.mark.parametrize("broken", [(float("nan"), 7), None])
def test_an_unreadable_ring_span_does_not_stop_the_housekeeping(
    ring: FlightRing, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, broken: Any
) -> None:
    def told(_fd: int) -> Any:
        if broken is None:
            raise InvalidInput("is none", where="ring")
        return broken

    async def story() -> None:
        front = Front()
        flights = FlightDumper(front, recorded(tmp_path, ring))  # type: ignore[arg-type]
        monkeypatch.setattr(module, "held_span", told)
        flights.housekeep(front.time)
        assert front.world.flight is not None
        assert front.world.flight["span_s"] == 0.0

    run(story)


def test_the_status_shows_the_span_and_size_of_the_recorder(ring: FlightRing, tmp_path: Path) -> None:
    async def story() -> None:
        front = Front()
        front.time = 31.0
        flights = FlightDumper(front, recorded(tmp_path, ring))  # type: ignore[arg-type]
        flights.housekeep(front.time)
        assert front.world.flight == {"span_s": 30.0, "bytes": 16 + 4, "last": None}

    run(story)
