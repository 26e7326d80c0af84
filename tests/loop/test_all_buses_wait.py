"""Waits for replies of several buses within a tick: which are read when, and what is never waited for."""

from math import inf
from types import SimpleNamespace
from typing import Any

import pytest

from twind.loop.bus.bus_wait import all_of, collect, ripe
from twind_drivers.bus import PortError
from twind_drivers.clock import FakeClock

MS = 0.001


class Reply:
    """Reader and port of one bus: its reply is expected at `earliest` and is there at `comes` (s)."""

    def __init__(self, clock: FakeClock, earliest: float, comes: float, deadline: float = 10 * MS) -> None:
        self._clock = clock
        self.earliest = earliest
        self.deadline = deadline
        self.comes = comes
        self.transport = self
        self.fed: list[float] = []  # s, each read
        self.next: tuple[float, float, float] | None = None  # of a chain: the same three
        self.error: PortError | None = None

    def arrival(self) -> float:
        read = bool(self.fed) and self.fed[-1] >= round(self.comes / MS, 6)
        return inf if read else self.comes

    def fileno(self) -> int:
        return -1

    def feed(self, now: float) -> bool:
        self.fed.append(round(now / MS, 6))
        if self.error is not None:
            raise self.error
        if now < self.comes:
            return False
        if self.next is None:
            return True
        self.earliest, self.comes, self.deadline = self.next
        self.next = None
        return False


class Waits(FakeClock):
    """Notes each wait: for the arrival of bytes in so many ports, or asleep."""

    def __init__(self) -> None:
        super().__init__()
        self.log: list[tuple[str, int | None, float]] = []

    def sleep_until(self, deadline: float) -> None:
        self.log.append(("sleep", None, round(deadline / MS, 6)))
        super().sleep_until(deadline)

    def wait(self, sources: Any, deadline: float) -> Any:
        self.log.append(("wait", len(sources), round(deadline / MS, 6)))
        return super().wait(sources, deadline)


@pytest.fixture
def clock() -> Waits:
    return Waits()


def readers(clock: Waits, *each: tuple[float, float]) -> Any:
    """Readers by the ms at which replies are expected, and at which they come."""
    return [Reply(clock, earliest * MS, comes * MS) for earliest, comes in each]


# ------------------------------------------------------------------------------- which are ready


def test_the_wait_ends_where_the_first_reply_is_expected(clock: Waits) -> None:
    assert list(ripe(readers(clock, (3, 3), (2, 2)), clock)) == [1]
    assert clock.log == [("sleep", None, 2.0)]


@pytest.mark.parametrize(("apart", "found"), [(0.1, [0, 1]), (0.15, [0, 1]), (0.16, [0])])
def test_replies_that_end_within_150_microseconds_are_read_together(
    clock: Waits, apart: float, found: list[int]
) -> None:
    assert list(ripe(readers(clock, (2, 2), (2 + apart, 3), (6, 6)), clock)) == found
    assert clock.now() == pytest.approx((2.0 + apart * (len(found) - 1)) * MS)


def test_a_reply_that_is_due_is_waited_for_until_the_next_one_is_expected(clock: Waits) -> None:
    clock.time = 3 * MS
    late, early, other = readers(clock, (2, 9), (5, 5), (1, 9))
    assert list(ripe([early, late, other], clock)) == []
    assert clock.log == [("wait", 2, 5.0)] and clock.now() == 5 * MS


def test_of_the_replies_that_are_due_those_with_bytes_are_ready(clock: Waits) -> None:
    clock.time = 3 * MS
    assert list(ripe(readers(clock, (9, 9), (2, 9), (3, 4)), clock)) == [2]
    assert clock.now() == 4 * MS


def test_the_wait_for_replies_that_are_due_ends_at_the_first_of_their_deadlines(clock: Waits) -> None:
    clock.time = 3 * MS
    first, second, third = readers(clock, (2, 20), (2, 20), (12, 20))
    first.deadline, third.deadline = 7 * MS, 1 * MS
    assert list(ripe([second, first, third], clock)) == []
    assert clock.log == [("wait", 2, 7.0)]


@pytest.mark.parametrize(("begins", "together"), [(3.1, True), (3.2, False)])
def test_a_reply_that_is_due_is_read_with_one_that_is_expected_at_once(
    clock: Waits, begins: float, together: bool
) -> None:
    clock.time = 3 * MS
    found = list(ripe(readers(clock, (2, 9), (begins, begins), (begins + 0.1, 9)), clock))
    assert found == ([0, 1] if together else [])
    assert clock.log == [("sleep", None, begins) if together else ("wait", 1, begins)]


# ------------------------------------------------------------------------------- until all are read


def collected(clock: Waits, *each: Any, **how: bool) -> tuple[float, list[Any], list[Any]]:
    """Collect; return the time of the first bytes (ms), which are left, and which were lost."""
    pairs: Any = [(SimpleNamespace(reader=reader), None) for reader in each]
    left = list(pairs)
    lost: list[Any] = []
    first = collect(left, clock, lambda pair, error: lost.append((pair, error)), **how)
    places = [pairs.index(pair) for pair in left]
    return round(first / MS, 6), places, [(pairs.index(pair), error) for pair, error in lost]


def test_one_bus_is_read_where_its_reply_is_expected(clock: Waits) -> None:
    [reader] = readers(clock, (2, 2))
    assert collected(clock, reader) == (2.0, [0], [])
    assert reader.fed == [2.0] and clock.log == [("sleep", None, 2.0)]


def test_one_bus_whose_reply_is_late_is_read_when_it_comes(clock: Waits) -> None:
    [reader] = readers(clock, (2, 4))
    assert collected(clock, reader) == (2.0, [0], [])
    assert reader.fed == [2.0, 4.0] and clock.log[1:] == [("wait", 1, 10.0)]


def test_one_bus_whose_reply_is_expected_now_is_not_slept_for(clock: Waits) -> None:
    clock.time = 2 * MS
    [reader] = readers(clock, (2, 4))
    assert collected(clock, reader)[0] == 4.0
    assert clock.log == [("wait", 1, 10.0)]


def test_a_silent_bus_is_read_a_last_time_at_its_deadline(clock: Waits) -> None:
    silent, other = readers(clock, (2, 50), (3, 3))
    assert collected(clock, silent, other) == (2.0, [0, 1], [])
    assert silent.fed == [2.0, 10.0] and other.fed == [3.0]


def test_a_bus_without_bytes_is_not_read(clock: Waits) -> None:
    slow, quick = readers(clock, (2, 6), (2, 4))
    quick.next = (5 * MS, 5 * MS, 10 * MS)
    collected(clock, slow, quick)
    assert slow.fed == [2.0, 6.0]
    assert quick.fed == [2.0, 4.0, 5.0]


def test_a_read_at_the_deadline_may_begin_the_next_reply_of_a_chain(clock: Waits) -> None:
    [reader] = readers(clock, (2, 10))
    reader.next = (12 * MS, 12 * MS, 20 * MS)
    collected(clock, reader)
    assert reader.fed == [2.0, 10.0, 12.0]


def test_a_further_reply_of_a_chain_is_read_once_although_its_deadline_has_passed(clock: Waits) -> None:
    [reader] = readers(clock, (2, 2))
    reader.next = (1 * MS, 1 * MS, 1.5 * MS)
    collected(clock, reader)
    assert reader.fed == [2.0, 2.0]


def test_a_lost_port_leaves_the_request_and_the_others_are_read(clock: Waits) -> None:
    broken, sound = readers(clock, (2, 2), (4, 4))
    broken.error = PortError("lower", "gone")
    assert collected(clock, broken, sound) == (2.0, [1], [(0, broken.error)])
    assert broken.fed == [2.0] and sound.fed == [4.0]


def test_a_request_without_reply_is_done_before_the_first_wait(clock: Waits) -> None:
    done, open_one = readers(clock, (50, 0), (2, 2))
    assert collected(clock, done, open_one, poll_first=True) == (0.0, [0, 1], [])
    assert done.fed == [0.0] and open_one.fed == [0.0, 2.0]


def test_a_bus_that_was_closed_is_not_waited_for(clock: Waits) -> None:
    clock.time = 3 * MS
    assert collected(clock, None) == (3.0, [0], [])
    assert clock.log == []


# ------------------------------------------------------------------------------- over several ticks


def test_scripts_are_awaited_all_and_the_first_error_is_raised() -> None:
    tasks: Any = [
        SimpleNamespace(done=False, error=error) for error in (None, ValueError("a"), KeyError("b"))
    ]
    steps = all_of(iter(tasks))
    for task in reversed(tasks):
        next(steps)
        task.done = True
    with pytest.raises(ValueError, match="a"):
        next(steps)


def test_no_script_is_awaited_for_no_tick() -> None:
    assert list(all_of([])) == []
