"""Real-time tests of flight ring."""

import os
import random
import signal
import time
from collections.abc import Callable, Iterator

import pytest

from tests.support.processes import until
from twind.flight import (
    EntryKind,
    FlightEntry,
    FlightRing,
    read,
)
from twind.flight import recorder_ring as ring_module


@pytest.fixture
def ring() -> Iterator[FlightRing]:
    ring = FlightRing.create(64 << 10, buses=2, transcript=4096)
    yield ring
    ring.close()


@pytest.fixture(scope="module", autouse=True)
def _same_process() -> Iterator[None]:
    """Writer and reader on one core need no time to agree; two processes wait, as in a robot."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ring_module, "SETTLE", 0.0)
        yield


def numbered(number: int) -> bytes:
    """Data that shows when it was mixed with another's: its number, again and again."""
    return number.to_bytes(4, "little") * (1 + number * 7919 % 120)


def flat_out(ring: FlightRing, longest: int) -> None:
    """Records 0, 1, 2, ... for ever; one in a while is split."""
    number = 0
    while True:
        data = numbered(number)
        if longest and number % 997 == 0:
            data = data[:4] * longest
        ring.append(EntryKind.IN, number % 200, number * 1.0, data)
        number += 1


def is_a_whole_run(entries: tuple[FlightEntry, ...]) -> bool:
    numbers = [int.from_bytes(one.data[:4], "little") for one in entries]
    run = numbers == list(range(numbers[0], numbers[0] + len(numbers))) if numbers else True
    return run and all(
        (one.time, one.bus) == (number, number % 200)
        and one.data == one.data[:4] * (len(one.data) // 4)
        and len(one.data) in (len(numbered(number)), 4 * 5000)
        for number, one in zip(numbers, entries, strict=True)
    )


def child(do: Callable[[], None]) -> int:
    pid = os.fork()
    if pid == 0:
        try:
            do()
        finally:
            os._exit(1)
    return pid


def test_a_reader_beside_a_writer_that_writes_flat_out_reads_whole_runs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(ring_module, "SETTLE", 0.001)
    ring = FlightRing.create(16 << 20)
    pid = child(lambda: flat_out(ring, 5000))
    reads = records = last = 0
    deadline = time.monotonic() + 10.0
    try:
        while reads <= 3 or records <= 1000:
            assert time.monotonic() < deadline, f"{reads} reads of {records} records in 10 s"
            entries = read(ring.fd).entries
            assert is_a_whole_run(entries)
            newest = int(entries[-1].time) if entries else last
            assert newest >= last
            last = newest
            reads = reads + 1
            records = records + len(entries)
    finally:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
    assert is_a_whole_run(read(ring.fd).entries)
    ring.close()


@pytest.mark.parametrize("size", [4096, 100_000])
def test_a_writer_killed_anywhere_leaves_whole_records(size: int) -> None:
    chance = random.Random(20261122)
    for kill in range(15):
        ring = FlightRing.create(size)
        pid = child(lambda ring=ring: flat_out(ring, size // 50))  # type: ignore[misc]
        is_early = kill % 3 == 0  # a kill among the first records; the others come after a few
        if not is_early:
            until(lambda ring=ring: len(read(ring.fd).entries) > 5, 10.0, "records")  # type: ignore[misc]
        time.sleep(chance.uniform(0.0, 0.01))
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        entries = read(ring.fd).entries
        numbers = [int(one.time) for one in entries]
        assert numbers or is_early
        oldest = numbers[0] if numbers else 0
        assert numbers == list(range(oldest, oldest + len(numbers)))
        assert all(one.data == one.data[:4] * (len(one.data) // 4) for one in entries)
        assert all(int.from_bytes(one.data[:4], "little") == one.time for one in entries)
        ring.close()
