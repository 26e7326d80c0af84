"""Reading the ring gives the end of what was written, whole and in order, whatever the writer does."""

import fcntl
import mmap
import os
import random
import sys
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from twind.exceptions import InvalidInput
from twind.flight import (
    NO_BUS,
    EntryKind,
    FlightContents,
    FlightEntry,
    FlightRing,
    held_span,
    pack,
    read,
    signature,
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


def entry(number: int, size: int) -> FlightEntry:
    """One whose every byte says which it is."""
    kind = list(EntryKind)[number % len(EntryKind)]
    return FlightEntry(number / 1000, kind, number % 3, random.Random(number).randbytes(size))


def is_the_end_of(read_back: tuple[FlightEntry, ...], written: list[FlightEntry]) -> bool:
    return list(read_back) == written[len(written) - len(read_back) :]


@examples(150)
@given(
    size=st.integers(4096, 20_000),
    sizes=st.lists(st.one_of(st.integers(0, 90), st.integers(0, 900), st.integers(0, 2048)), max_size=300),
)
def test_a_ring_reads_back_the_end_of_its_entries(size: int, sizes: list[int]) -> None:
    written = [entry(number, length) for number, length in enumerate(sizes)]
    ring = FlightRing.create(size, buses=1, transcript=64)
    try:
        for one in written:
            ring.append(one.kind, one.bus, one.time, one.data)
        found = read(ring.fd).entries
        fits = sum(len(one.data) for one in written) + 40 * len(written) < size // 3
        assert is_the_end_of(found, written)
        assert ring.refused == 0
        if written:
            assert found[-1] == written[-1]
            assert not fits or len(found) == len(written)
    finally:
        ring.close()


def test_most_of_the_ring_is_there_to_be_read(ring: FlightRing) -> None:
    written = [entry(number, 300) for number in range(1000)]
    for one in written:
        ring.append(one.kind, one.bus, one.time, one.data)
    found = read(ring.fd).entries
    assert is_the_end_of(found, written)
    assert len(found) * 316 > 0.6 * (64 << 10)  # 3 of 300 bytes fit into a segment of 1024


def test_a_record_over_half_of_the_ring_is_left_out_and_counted(ring: FlightRing) -> None:
    half = 32 << 10
    ring.append(EntryKind.IN, 0, 1.0, b"before")
    ring.append(EntryKind.ARRAYS, NO_BUS, 2.0, bytes(half + 1))
    assert ring.refused == 1
    ring.append(EntryKind.ARRAYS, NO_BUS, 3.0, bytes(half))
    assert ring.refused == 1
    assert [(one.time, len(one.data)) for one in read(ring.fd).entries] == [(1.0, 6), (3.0, half)]


def test_a_split_record_whose_beginning_was_overwritten_is_left_out(ring: FlightRing) -> None:
    long = entry(0, 30_000)
    ring.append(long.kind, long.bus, long.time, long.data)
    written = [long] + [entry(number, 500) for number in range(1, 70)]
    for one in written[1:]:
        ring.append(one.kind, one.bus, one.time, one.data)
        assert is_the_end_of(read(ring.fd).entries, written[: written.index(one) + 1])
    assert long not in read(ring.fd).entries


def test_any_bytes_like_object_may_be_appended(ring: FlightRing) -> None:
    for data in (b"abc", bytearray(b"abc"), memoryview(b"abc"), memoryview(bytearray(5000))):
        ring.append(EntryKind.IN, 1, 0.5, data)
    assert [len(one.data) for one in read(ring.fd).entries] == [3, 3, 3, 5000]


def test_the_last_transcript_of_each_bus_survives_the_overwriting_of_the_ring(ring: FlightRing) -> None:
    first = (entry(1, 40), entry(2, 50))
    second = (entry(3, 60),)
    ring.keep(0, pack(first))
    ring.keep(1, pack(first))
    for number in range(5):
        ring.keep(1, pack([entry(number, 10)]))
    ring.keep(1, pack(second))
    for _ in range(1000):
        ring.append(EntryKind.IN, 0, 0.0, bytes(200))
    assert read(ring.fd).kept == {0: first, 1: second}


def test_a_transcript_that_is_too_long_or_of_no_bus_leaves_the_last_one(ring: FlightRing) -> None:
    ring.keep(0, pack([entry(1, 40)]))
    ring.keep(0, bytes(4097))
    ring.keep(2, b"")
    assert ring.refused == 2
    assert read(ring.fd).kept == {0: (entry(1, 40),)}


def test_a_ring_that_nothing_was_written_to_is_empty(ring: FlightRing) -> None:
    assert read(ring.fd) == FlightContents()


def test_a_reader_can_neither_write_nor_truncate_the_ring(ring: FlightRing) -> None:
    for change in (
        lambda: os.pwrite(ring.fd, b"X", 0),
        lambda: os.ftruncate(ring.fd, 0),
        lambda: os.ftruncate(ring.fd, 1 << 20),
        lambda: mmap.mmap(ring.fd, 4096),
        lambda: fcntl.fcntl(ring.fd, fcntl.F_ADD_SEALS, fcntl.F_SEAL_WRITE),
    ):
        with pytest.raises(PermissionError):
            change()
    ring.append(EntryKind.IN, 0, 1.0, b"goes on")
    assert len(read(ring.fd).entries) == 1


def test_every_page_is_there_before_the_first_tick(ring: FlightRing) -> None:
    assert os.fstat(ring.fd).st_blocks * 512 >= ring.size


def test_a_signature_is_readable_and_damages_no_entry(ring: FlightRing) -> None:
    assert signature(ring.fd) == bytes(16)
    ring.append(EntryKind.IN, 0, 1.0, b"data")
    ring.sign(bytes(range(16)))
    assert signature(ring.fd) == bytes(range(16))
    assert [each.data for each in read(ring.fd).entries] == [b"data"]


def test_the_age_of_the_oldest_entry_is_unknown_while_its_segment_is_overwritten(
    ring: FlightRing, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in range(100):
        ring.append(EntryKind.IN, 0, 1.0 + number, bytes(900))
    oldest, size = held_span(ring.fd)
    assert oldest == read(ring.fd).entries[0].time
    real = os.pread

    def turned(fd: int, count: int, at: int) -> bytes:
        """The writer goes round between two looks of a reader."""
        if count == ring_module.HEAD:
            monkeypatch.undo()
            for _ in range(100):
                ring.append(EntryKind.IN, 0, float("nan"), bytes(900))
        return real(fd, count, at)

    monkeypatch.setattr(os, "pread", turned)
    assert held_span(ring.fd) == (None, size)


def test_a_file_that_is_no_ring_is_refused() -> None:
    with pytest.raises(ValueError, match="at least 4096"):
        FlightRing.create(4095)
    for data in (b"", bytes(100), b"twring1\0" + bytes(92)):
        fd = os.memfd_create("foreign")
        try:
            os.write(fd, data)
            with pytest.raises(InvalidInput, match="none of this version"):
                read(fd)
        finally:
            os.close(fd)


# ------------------------------------------------------------------------------- a writer that is interrupted


def test_read_at_every_line_of_the_writer_it_gives_whole_records_alone(ring: FlightRing) -> None:
    """Between any two lines the writer may be killed for good."""
    written: list[FlightEntry] = []
    kept: list[tuple[FlightEntry, ...]] = []
    looks = 0

    def look(frame: FrameType, event: str, _: Any) -> Callable[..., Any] | None:
        nonlocal looks
        if frame.f_code.co_filename != ring_module.__file__:
            return None
        if event == "line":
            looks += 1
            sys.settrace(None)
            found = read(ring.fd)
            assert is_the_end_of(found.entries, written) or is_the_end_of(found.entries, written[:-1])
            assert found.kept.get(0, ()) in kept[-2:] or not kept[:-1]
            sys.settrace(look)
        return look

    before = sys.gettrace()
    try:
        for number in range(80):
            written.append(entry(number, (7 * number) % 60 if number % 9 else 2500))
            one = written[-1]
            sys.settrace(look)
            ring.append(one.kind, one.bus, one.time, one.data)
            sys.settrace(None)
            if number % 10 == 0:
                kept.append((one,))
                sys.settrace(look)
                ring.keep(0, pack(kept[-1]))
                sys.settrace(None)
    finally:
        sys.settrace(before)
    assert looks > 500
    assert is_the_end_of(read(ring.fd).entries, written)
