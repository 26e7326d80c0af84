"""Commands that wait: few, the newest of each kind, and never in a hurry."""

import threading
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.bridge.ros.ros_command_queue import PACE, ROOM, RosCommand, RosCommandQueue
from twind.bridge.ros.ros_trajectory import CommandHeader

NAMES = st.sets(st.sampled_from("abcd"), min_size=1).map(lambda joints: tuple(sorted(joints)))


def command(*joints: str, stamp: int = 0, frame: str = "", came: float = 0.0) -> RosCommand:
    return RosCommand(b"", CommandHeader(stamp, 0, frame, joints), came)


class StubClock:
    """Clock that the test moves."""

    time = 100.0

    def now(self) -> float:
        return self.time


def taken(inbox: RosCommandQueue, clock: StubClock, *, good: bool = True) -> list[RosCommand]:
    """All that waits, each when it is time for it. `good`: each is accepted."""
    found = []
    while True:
        clock.time += PACE
        command = inbox.take(0.0)
        if command is None:
            return found
        if good:
            inbox.accepted(command)
        found.append(command)


@pytest.mark.parametrize("good", [True, False])
def test_a_newer_command_for_the_same_joints_drops_the_waiting_one_only_if_it_is_accepted(good: bool) -> None:
    clock = StubClock()
    inbox = RosCommandQueue(clock.now)
    old = command("a")
    other = command("b")
    new = command("a", "c")
    for each in (old, other, new):
        assert inbox.put(each) == []
    assert taken(inbox, clock, good=good) == ([new, other] if good else [new, old, other])
    assert inbox.dropped() == ((1, old.head) if good else None)


def test_a_newer_command_is_not_voided_by_an_accepted_one() -> None:
    clock = StubClock()
    inbox = RosCommandQueue(clock.now)
    inbox.put(command("a"))
    clock.time += PACE
    first = inbox.take(0.0)
    assert first is not None
    inbox.put(command("a", frame="newer"))
    inbox.accepted(first)
    assert [each.head and each.head.frame for each in taken(inbox, clock)] == ["newer"]


def test_later_followed_and_malformed_commands_are_kept() -> None:
    clock = StubClock()
    inbox = RosCommandQueue(clock.now)
    later = command("a", stamp=7)
    followed = command("a")
    malformed = RosCommand(b"x", None, 0.0)
    now = command("a")
    followed.report = lambda result: None
    for each in (later, followed, malformed, now):
        inbox.put(each)
    assert taken(inbox, clock) == [later, followed, malformed, now]
    assert inbox.dropped() is None


@given(st.lists(st.tuples(NAMES, st.integers(0, 1)), max_size=60))
def test_the_command_queue_is_bounded_keeps_the_newest_and_counts_all_drops(
    asked: list[tuple[tuple[str, ...], int]],
) -> None:
    clock = StubClock()
    inbox = RosCommandQueue(clock.now)
    commands = [command(*joints, stamp=stamp) for joints, stamp in asked]
    for each in commands:
        inbox.put(each)
    left = taken(inbox, clock)
    assert len(left) <= ROOM
    assert not commands or commands[-1] in left
    for place, first in enumerate(left):  # none is done after a newer one that leaves nothing of it
        for later in left[place + 1 :]:
            assert first.head and later.head
            older = later.number < first.number and later.head.sec == first.head.sec == 0
            assert not (older and set(first.head.joints) >= set(later.head.joints))
    dropped = inbox.dropped()
    assert (dropped[0] if dropped else 0) == len(commands) - len(left)


def test_a_full_queue_returns_the_followed_command_it_drops() -> None:
    inbox = RosCommandQueue(StubClock().now)
    first = command("a", stamp=1)
    first.report = lambda result: None
    gone = [inbox.put(each) for each in [first, *(command("a", stamp=2 + place) for place in range(ROOM))]]
    assert gone[-1] == [first] and not any(gone[:-1])


def test_two_commands_are_taken_at_least_one_pace_apart() -> None:
    clock = StubClock()
    inbox = RosCommandQueue(clock.now)
    inbox.put(command("a"))
    inbox.put(command("b"))
    assert inbox.take(0.0) is not None
    clock.time += PACE / 2.0
    assert inbox.take(0.0) is None
    clock.time += PACE / 2.0
    assert inbox.take(0.0) is not None


def test_drops_are_reported_at_most_once_a_second() -> None:
    clock = StubClock()
    inbox = RosCommandQueue(clock.now)
    for place in range(ROOM + 2):
        inbox.put(command("a", stamp=7, frame=str(place)))
    assert inbox.dropped() == (2, CommandHeader(7, 0, "1", ("a",)))
    inbox.put(command("a", stamp=7))
    assert inbox.dropped() is None
    clock.time += 1.0
    assert inbox.dropped() == (1, CommandHeader(7, 0, "2", ("a",)))


def test_a_wake_ends_the_wait_for_a_command() -> None:
    inbox = RosCommandQueue()
    begun = time.monotonic()
    inbox.wake()
    assert inbox.take(20.0) is None
    assert time.monotonic() - begun < 20.0


def test_a_wake_ends_the_wait_for_the_pace_but_a_new_command_does_not() -> None:
    clock = StubClock()  # which stands still: the time never comes
    inbox = RosCommandQueue(clock.now)
    inbox.put(command("a"))
    assert inbox.take(0.0) is not None
    clock.time -= 30.0
    begun = time.monotonic()
    found = list[RosCommand | None]()
    waiting = threading.Thread(target=lambda: found.append(inbox.take(20.0)))
    waiting.start()
    for place in range(3):
        inbox.put(command("a", stamp=place))
        time.sleep(0.05)
    assert waiting.is_alive()
    inbox.wake()
    waiting.join(20.0)
    assert found == [None] and time.monotonic() - begun < 15.0
