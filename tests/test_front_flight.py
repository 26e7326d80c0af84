"""When a flight file is written: at a fault, with what followed, when asked, and when the loop is gone."""

import asyncio
import os
from collections.abc import Callable, Coroutine, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from stand_in import briefing, overview, tick

from twind import link
from twind.flight import Kind, Ring, load
from twind.front import flight as module
from twind.front.flight import AFTERMATH, AGAIN, Flights, Recorded
from twind.front.world import World


@pytest.fixture
def ring() -> Iterator[Ring]:
    ring = Ring.create(1 << 20)
    ring.append(Kind.NEWS, 255, 1.0, b"news")
    yield ring
    ring.close()


class Front:
    """As much of a front as there needs to be; its time is ours."""

    def __init__(self) -> None:
        self.loop = asyncio.get_running_loop()
        self.world = World(briefing(2))
        self.world.take(tick(1.0, 1, 2))
        self.world.take(overview(1.0, 1, 2))
        self.log, self.lines = SimpleNamespace(say=self._say), list[tuple[str, str]]()
        self.time = 100.0

    def now(self) -> float:
        return self.time

    def _say(self, level: str, event: str, now: float, **fields: Any) -> None:
        self.lines.append((level, event))


class Call:
    """One call, and what it was answered."""

    def __init__(self, **parameters: Any) -> None:
        self.parameters, self.answers = parameters, list[Any]()

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


async def settled(flights: Flights) -> None:
    """Until the thread has nothing to do, and what it did is told."""
    await asyncio.get_running_loop().run_in_executor(None, flights._thread.submit(int).result)
    await asyncio.sleep(0)


def names(folder: Path) -> list[str]:
    return sorted(path.name[24:-7] for path in folder.glob("flight-*.flight"))


@pytest.mark.parametrize("state", ["fault", "inhibited", "estop"])
def test_a_fault_is_written_with_what_followed_and_by_what_latched_it(
    ring: Ring, tmp_path: Path, state: str
) -> None:
    async def story() -> None:
        front = Front()
        flights = Flights(front, Recorded(tmp_path, ring.fd))  # type: ignore[arg-type]
        flights.event(event("LATENCY_WARN", "warning", 49.0))
        for code in ("BUS_ERRORS", "STATE_STALE", "LOOP_LATE"):
            flights.event(event(code, "warning"))
        flights.event(event(state))
        flights.tend(front.time)
        front.time += AFTERMATH - 0.01
        flights.tend(front.time)
        await settled(flights)
        assert names(tmp_path) == []
        ring.append(Kind.NEWS, 255, 2.0, b"aftermath")
        front.time += 0.02
        flights.tend(front.time)
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


def test_faults_that_follow_at_once_share_a_file_and_none_goes_unwritten(ring: Ring, tmp_path: Path) -> None:
    async def story() -> None:
        front = Front()
        flights = Flights(front, Recorded(tmp_path, ring.fd))  # type: ignore[arg-type]
        written = []
        for step in range(300):  # a fault each 0.5 s for half a minute, rounds of 0.1 s
            if step % 5 == 0:
                flights.event(event("fault", time=float(step)))
            front.time += 0.1
            flights.tend(front.time)
            await settled(flights)
            written.append(len(names(tmp_path)))
        assert written[round(AFTERMATH / 0.1) + 1] == 1
        assert written[-1] == 1 + int((30.0 - AFTERMATH) / AGAIN)
        await flights.end()
        assert len(names(tmp_path)) == written[-1] + 1  # the last one is not waited for

    run(story)


@pytest.mark.parametrize("code", ["connected", "END", "BUS_ERRORS", "NOTE"])
def test_what_no_operator_must_acknowledge_is_not_written(ring: Ring, tmp_path: Path, code: str) -> None:
    async def story() -> None:
        front = Front()
        flights = Flights(front, Recorded(tmp_path, ring.fd))  # type: ignore[arg-type]
        flights.event(event(code, "error"))
        flights.event(event("END"))
        front.time += 60.0
        flights.tend(front.time)
        await flights.end()
        assert names(tmp_path) == []

    run(story)


def test_a_dump_is_answered_with_its_path_and_takes_only_names_of_files(ring: Ring, tmp_path: Path) -> None:
    async def story() -> None:
        front = Front()
        flights = Flights(front, Recorded(tmp_path / "new", ring.fd))  # type: ignore[arg-type]
        for name in ("", "../x", "a b", "x" * 65, "ä", "a/b", "a.b"):
            call = Call(name=name)
            flights.dump(call)  # type: ignore[arg-type]
            assert call.answers == ["invalid name"]
        first, second, third = Call(name="wob_1-b"), Call(), Call()
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


def test_without_a_recorder_that_is_said_and_nothing_is_in_the_status(tmp_path: Path) -> None:
    async def story() -> None:
        front = Front()
        flights = Flights(front, None)  # type: ignore[arg-type]
        call = Call()
        flights.dump(call)  # type: ignore[arg-type]
        flights.event(event("fault"))
        front.time += 60.0
        flights.tend(front.time)
        await flights.end()
        assert call.answers == ["NotWritten"]
        assert front.world.flight is None

    run(story)


def test_a_disk_that_takes_nothing_costs_a_line_and_is_counted(
    ring: Ring, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_fd: int) -> None:
        raise OSError(28, "No space left on device")

    async def story() -> None:
        front = Front()
        flights = Flights(front, Recorded(tmp_path, ring.fd))  # type: ignore[arg-type]
        monkeypatch.setattr(os, "fsync", full)
        call = Call()
        flights.dump(call)  # type: ignore[arg-type]
        await settled(flights)
        flights.event(event("fault"))
        front.time += 60.0
        flights.tend(front.time)
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
def test_only_a_loop_that_died_without_farewell_has_crashed(
    ring: Ring,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    farewell: bool,
    orphaned: bool,
    found: list[str],
) -> None:
    monkeypatch.setattr(module, "ORPHANED", 0.0)

    async def story() -> None:
        flights = Flights(Front(), Recorded(tmp_path, ring.fd))  # type: ignore[arg-type]
        if farewell:
            flights.event(event("END"))
        if orphaned:
            monkeypatch.setattr(os, "getppid", lambda: 1)
        await flights.end()
        assert names(tmp_path) == found

    run(story)


def test_the_recorder_of_a_daemon_that_is_gone_is_written_at_once_and_let_go(
    ring: Ring, tmp_path: Path
) -> None:
    wreck = os.dup(ring.fd)

    async def story() -> None:
        front = Front()
        flights = Flights(front, Recorded(tmp_path, ring.fd, wreck))  # type: ignore[arg-type]
        await settled(flights)
        flights.event(event("END"))
        await flights.end()
        assert names(tmp_path) == ["CRASH"]
        meta = load(next(tmp_path.iterdir())).meta
        assert (meta["reason"], meta["state"]) == ("crash", None)

    run(story)
    with pytest.raises(OSError, match="Bad file"):
        os.fstat(wreck)


def test_a_wreck_that_is_none_costs_a_line(ring: Ring, tmp_path: Path) -> None:
    async def story() -> None:
        front = Front()
        flights = Flights(front, Recorded(tmp_path, ring.fd, os.memfd_create("foreign")))  # type: ignore[arg-type]
        await settled(flights)
        assert front.lines == [("error", "FLIGHT_NOT_WRITTEN")]

    run(story)


def test_the_status_says_how_much_is_held(ring: Ring, tmp_path: Path) -> None:
    async def story() -> None:
        front = Front()
        front.time = 31.0
        flights = Flights(front, Recorded(tmp_path, ring.fd))  # type: ignore[arg-type]
        flights.tend(front.time)
        assert front.world.flight == {"span_s": 30.0, "bytes": 16 + 4, "last": None}

    run(story)
