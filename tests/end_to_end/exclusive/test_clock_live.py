"""Real-time tests of clock."""

from collections.abc import Iterator
from math import inf

import pytest

from tests.support.clock_rig import Later, Pipe
from twind_drivers.clock import MonotonicClock


@pytest.fixture
def pipe() -> Iterator[Pipe]:
    pipe = Pipe()
    yield pipe
    pipe.close()


def test_a_sleep_ends_at_its_deadline_or_later_and_a_past_one_at_once() -> None:
    clock = MonotonicClock()
    deadline = clock.now() + 0.005
    clock.sleep_until(deadline)
    assert clock.now() >= deadline
    clock.sleep_until(deadline - 100.0)
    clock.sleep_until(-inf)


def test_a_wait_without_bytes_ends_at_its_deadline(pipe: Pipe) -> None:
    clock = MonotonicClock()
    deadline = clock.now() + 0.003
    clock.wait([pipe], deadline)
    assert clock.now() >= deadline - 0.0005  # poll counts whole milliseconds and may wake half a one early


def test_a_source_without_descriptor_is_asked_each_millisecond_and_no_more_often(pipe: Pipe) -> None:
    clock = MonotonicClock()
    begin = clock.now()
    later = Later(begin + 0.02)
    clock.wait([pipe, later], begin + 600.0)
    assert 0.02 <= clock.now() - begin < 60.0
    assert 2 <= later.asked <= 22
    never = Later(inf)
    clock.wait([never], clock.now() + 0.01)
    assert 2 <= never.asked <= 12
