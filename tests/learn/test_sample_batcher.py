"""The queue between who listens and who writes: never waits, loses the oldest, says so in the next batch."""

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from tests.support.spool_rig import ROBOT, some
from twind.client.clock_pair import ClockPair
from twind.learn.streaming.sample_batcher import SampleBatcher
from twind.learn.streaming.stream_samples import PostMessage, SampleBatch, StreamedRobot


class Watch:
    def __init__(self) -> None:
        self.time = 50.0

    def __call__(self) -> float:
        return self.time

    def clocks(self) -> ClockPair:
        return ClockPair(self.time, round(self.time * 1e9))


def batcher(size: int = 4, age: float = 1.0, room: int = 3) -> tuple[SampleBatcher, Watch]:
    watch = Watch()
    return SampleBatcher(size, age, watch, watch.clocks, room), watch


def taken(found: SampleBatcher) -> list[SampleBatch | PostMessage]:
    batches = []
    while (one := found.take(0.0)) is not None:
        batches.append(one)
    return batches


def ticks(batches: list[SampleBatch | PostMessage]) -> list[list[int]]:
    return [[each.tick for each in one.samples] for one in batches if isinstance(one, SampleBatch)]


def test_a_batch_is_closed_when_it_is_full() -> None:
    found, _ = batcher()
    for tick in range(9):
        found.put(some(tick), ROBOT)
    assert ticks(taken(found)) == [[0, 1, 2, 3], [4, 5, 6, 7]]
    found.end()
    assert ticks(taken(found)) == [[8]]


def test_a_batch_is_closed_when_it_is_old_counted_from_its_first() -> None:
    found, watch = batcher()
    found.put(some(0), ROBOT)
    watch.time += 0.9
    found.put(some(1), ROBOT)
    assert found.take(0.0) is None
    watch.time += 0.1
    (one,) = taken(found)
    assert isinstance(one, SampleBatch)
    assert one.clocks == ClockPair(50.0, 50_000_000_000)
    assert ticks([one]) == [[0, 1]]


def test_another_mode_other_joints_or_a_loss_begin_a_batch_of_their_own() -> None:
    found, _ = batcher(size=100, room=100)
    found.put(some(0), ROBOT)
    found.put(some(1), StreamedRobot("h24", "one", "0.1.0", "sim"))
    found.put(some(2)._replace(names=["a", "b"]), ROBOT)
    found.put(some(9)._replace(names=["a", "b"], dropped=6), ROBOT)
    found.end()
    batches = taken(found)
    assert ticks(batches) == [[0], [1], [2], [9]]
    assert [one.lost["daemon"] for one in batches if isinstance(one, SampleBatch)] == [0, 0, 0, 6]


def test_pictures_stand_in_the_line() -> None:
    found, _ = batcher(size=1)
    found.put(some(0), ROBOT)
    found.add(PostMessage(b"jpeg", {}))
    found.put(some(1), ROBOT)
    first, second, third = taken(found)
    assert isinstance(second, PostMessage)
    assert ticks([first, third]) == [[0], [1]]


@given(st.lists(st.sampled_from(["put", "put", "put", "picture", "take", "give back"]), max_size=60))
def test_every_sample_is_taken_once_or_counted_as_lost_before_the_next(steps: list[str]) -> None:
    found, _ = batcher(size=2, room=2)
    tick = 0
    took = []
    pictures = 0
    for step in steps:
        if step == "put":
            found.put(some(tick), ROBOT)
            tick += 1
        elif step == "picture":
            found.add(PostMessage(b"", {}))
            pictures += 1
        elif (one := found.take(0.0)) is not None:
            if step == "take":
                took.append(one)
            else:
                found.give_back(one)
    found.put(some(tick), ROBOT)
    found.end()
    batches = [one for one in [*took, *taken(found)] if isinstance(one, SampleBatch)]
    seen = [each.tick for one in batches for each in one.samples]
    assert seen == sorted(set(seen))
    assert seen[-1] == tick
    assert len(seen) + sum(one.lost["here"] for one in batches) == tick + 1
    for before, after in pairwise(batches):
        assert after.samples[0].tick - before.samples[-1].tick - 1 == after.lost["here"]
    assert found.samples == tick + 1
