"""From memory to the disk: a disk that takes nothing holds up nobody, and what it costs is counted."""

import time
from collections.abc import Iterator

import pytest

from tests.support.processes import until
from tests.support.spool_rig import ROBOT, WIDE, folder, some
from twind.client.clock_pair import clocks
from twind.learn.streaming.sample_batcher import SampleBatcher
from twind.learn.streaming.spool import Spool
from twind.learn.streaming.spool_writer import SpoolWriter

ROOM = 3


@pytest.fixture
def spool() -> Iterator[Spool]:
    with folder() as place, Spool(place, WIDE, time.monotonic(), time.time()) as found:
        yield found


def numbers(spool: Spool) -> list[int]:
    found = []
    after = 0
    while (kept := spool.oldest(after)) is not None:
        after = kept.sequence
        found.append(after)
    return found


def test_a_full_disk_drops_the_oldest_samples_in_memory_and_is_reported_once(spool: Spool) -> None:
    lines: list[str] = []
    basket = SampleBatcher(2, 60.0, time.monotonic, clocks, ROOM)
    keeping = SpoolWriter(basket, spool, lambda: None, lines.append, patience=0.02)
    pages = spool._base.execute("PRAGMA page_count").fetchone()[0]
    spool._base.execute(f"PRAGMA max_page_count={pages}")
    wide = [some(tick)._replace(names=["x" * 20_000]) for tick in range(40)]
    keeping.start()
    began = time.monotonic()
    for each in wide:
        basket.put(each, ROBOT)
    assert time.monotonic() - began < 2.0, "who listens waited for the disk"
    until(lambda: keeping.error, 10.0, "it is told")
    assert "full" in lines[0]
    lost = keeping.dropped_messages
    assert lost >= len(wide) // 2 - ROOM - 1
    spool._base.execute("PRAGMA max_page_count=1000000")
    keeping.finish(10.0)
    assert keeping.error == "" and len(lines) == 2 and "again" in lines[1]
    assert (keeping.dropped_messages, spool.tally.dropped) == (0, basket.dropped)
    assert spool.tally.waiting + spool.tally.dropped == len(wide) // 2
    assert numbers(spool) == list(range(1, spool.tally.waiting + 1))


def test_samples_that_a_full_disk_rejects_at_the_end_are_kept_in_memory(spool: Spool) -> None:
    basket = SampleBatcher(2, 60.0, time.monotonic, clocks, ROOM)
    keeping = SpoolWriter(basket, spool, lambda: None, lambda line: None, patience=0.02)
    pages = spool._base.execute("PRAGMA page_count").fetchone()[0]
    spool._base.execute(f"PRAGMA max_page_count={pages}")
    keeping.start()
    for tick in range(3):
        basket.put(some(tick)._replace(names=["x" * 20_000]), ROBOT)
    until(lambda: keeping.error, 10.0, "it is told")
    keeping.finish(0.1)
    until(lambda: basket.untaken_count == 2, 10.0, "both are there still")
    spool._base.execute("PRAGMA max_page_count=1000000")
    keeping.finish(10.0)
    assert (basket.untaken_count, spool.tally.waiting, spool.tally.dropped) == (0, 2, 0)


def test_an_open_batch_is_written_at_the_end(spool: Spool) -> None:
    woken: list[None] = []
    basket = SampleBatcher(32, 60.0, time.monotonic, clocks)
    keeping = SpoolWriter(basket, spool, lambda: woken.append(None), lambda line: None, patience=0.02)
    keeping.start()
    basket.put(some(1), ROBOT)
    keeping.finish(10.0)
    kept = spool.oldest()
    assert kept is not None and kept.message.samples == 1
    assert woken == [None]
