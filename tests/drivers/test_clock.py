"""Time that waits for nobody, and time that moves only when somebody waits."""

import os
from collections.abc import Iterator
from math import inf

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.clock_rig import Coming, Later, Pipe
from tests.support.examples import examples
from twind_drivers.clock import Clock, FakeClock, MonotonicClock

TIMES = st.floats(-1e6, 1e6) | st.just(inf) | st.just(-inf)


@pytest.fixture
def pipe() -> Iterator[Pipe]:
    pipe = Pipe()
    yield pipe
    pipe.close()


# ------------------------------------------------------------------------------------- the fake one


@examples(50)
@given(st.lists(st.tuples(st.booleans(), TIMES, st.lists(TIMES, max_size=3)), max_size=10))
def test_fake_time_never_goes_back_and_stops_at_the_first_thing_to_happen(
    waits: list[tuple[bool, float, list[float]]],
) -> None:
    clock: Clock = FakeClock(5.0)
    for sleeps, deadline, arrivals in waits:
        before = clock.now()
        if sleeps:
            clock.sleep_until(deadline)
            assert clock.now() == max(before, deadline)
        else:
            ready = clock.wait([Coming(at) for at in arrivals], deadline)
            assert clock.now() == max(before, min([deadline, *arrivals]))
            assert list(ready) == [place for place, at in enumerate(arrivals) if at <= clock.now()]


# ------------------------------------------------------------------------------------- the kernel's


def test_bytes_a_hang_up_or_a_past_deadline_end_a_wait_long_before_its_time(pipe: Pipe) -> None:
    clock = MonotonicClock()
    idle = Pipe()
    begin = clock.now()
    assert list(clock.wait([idle, pipe], begin - 1.0)) == []
    os.write(pipe.theirs, b"x")
    assert list(clock.wait([idle, pipe], begin + 600.0)) == [1]
    os.read(pipe.ours, 1)
    os.close(pipe.theirs)
    pipe.theirs = -1
    assert list(clock.wait([pipe, idle], begin + 600.0)) == [0]
    idle.close()
    assert clock.now() < begin + 60.0


def test_a_closed_descriptor_wakes_its_reader() -> None:
    clock = MonotonicClock()
    pipe = Pipe()
    pipe.close()
    begin = clock.now()
    clock.wait([pipe], begin + 600.0)
    assert clock.now() < begin + 60.0


def test_ports_replugged_again_and_again_do_not_grow_without_end() -> None:
    clock = MonotonicClock()
    ours = []
    for _ in range(100):
        ours.append(pipe := Pipe())
        clock.wait([pipe], 0.0)
    assert len(clock.polls) <= 65
    os.write(pipe.theirs, b"x")
    clock.wait([pipe], clock.now() + 600.0)  # still polled rightly
    for pipe in ours:
        pipe.close()


def test_beside_a_source_without_descriptor_bytes_and_what_is_there_already_end_a_wait(pipe: Pipe) -> None:
    clock = MonotonicClock()
    begin = MonotonicClock().now()
    assert list(clock.wait([pipe, Later(-inf)], begin + 600.0)) == [1]
    os.write(pipe.theirs, b"x")
    assert list(clock.wait([Later(inf), pipe], begin + 600.0)) == [1]
    assert sorted(clock.wait([Later(-inf), pipe], begin + 600.0)) == [0, 1]
    assert clock.now() < begin + 60.0


def test_a_machine_that_never_slept_has_slept_for_nothing_and_it_only_grows() -> None:
    clock = MonotonicClock()
    first = clock.suspended()
    assert first > -0.1  # the two clocks are read one after the other
    assert clock.suspended() - first < 0.1
