"""The dead man: no beat, no supply."""

from hypothesis import given
from hypothesis import strategies as st

from twind.power.dead_man import DeadMan

TIMEOUT = 0.1


def test_the_relay_is_open_until_the_loop_beats_and_asks_for_it() -> None:
    dead_man = DeadMan(TIMEOUT)
    assert not dead_man.is_closed(0, True, 10.0), "a wish without a beat"
    assert not dead_man.tripped
    assert not dead_man.is_closed(1, False, 10.01)
    assert dead_man.is_closed(2, True, 10.02)


def test_a_missed_beat_opens_it_and_the_next_beat_does_not_close_it() -> None:
    dead_man = DeadMan(TIMEOUT)
    assert dead_man.is_closed(1, True, 10.0)
    assert dead_man.is_closed(1, True, 10.0999)
    assert not dead_man.is_closed(1, True, 10.1001)
    assert dead_man.tripped
    assert not dead_man.is_closed(2, True, 10.2), "a loop that goes on closes it without a word"
    assert not dead_man.is_closed(3, False, 10.21)
    assert not dead_man.tripped
    assert dead_man.is_closed(4, True, 10.22)


def test_a_beat_counts_for_the_whole_timeout() -> None:
    dead_man = DeadMan(0.25)
    assert dead_man.is_closed(1, True, 10.0)
    assert dead_man.is_closed(1, True, 10.25)
    assert not dead_man.is_closed(1, True, 10.26)


def test_an_open_relay_does_not_trip() -> None:
    dead_man = DeadMan(TIMEOUT)
    assert not dead_man.is_closed(1, False, 10.0)
    assert not dead_man.is_closed(1, False, 11.0)
    assert not dead_man.tripped


@given(st.lists(st.tuples(st.booleans(), st.booleans(), st.floats(0.0, 0.3)), max_size=60))
def test_it_is_never_closed_without_a_beat_within_the_timeout(
    rounds: list[tuple[bool, bool, float]],
) -> None:
    dead_man = DeadMan(TIMEOUT)
    now = 10.0
    beat = 0
    beat_at = None
    wishes = []
    for beats, wanted, passed in rounds:
        now += passed
        if beats:
            beat += 1
            beat_at = now
        wishes.append(wanted)
        if dead_man.is_closed(beat, wanted, now):
            assert wanted
            assert beat_at is not None
            assert now - beat_at <= TIMEOUT
