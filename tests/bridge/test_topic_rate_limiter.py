"""Rate of a robot's news for a remote client: the requested one, from the slowest rate that suffices."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.bridge.fleet.topic_rate_limiter import TopicRateLimiter, keys, offered
from twind.bridge.zenoh.zenoh_keys import RATES
from twind.client import NotCarried


@given(st.floats(0.01, 2000.0))
def test_the_rate_that_is_sent_is_enough_and_no_slower_one_would_be(rate: float) -> None:
    chosen = offered(rate)
    assert chosen in RATES
    slower = RATES[: RATES.index(chosen)]
    assert all(float(each) < rate for each in slower)
    assert chosen == "full" or float(chosen) >= rate


def test_topics_have_their_keys_and_one_that_is_not_sent_is_refused_with_those_that_are() -> None:
    assert keys(["state", "events"], 5.0) == {"state": ("state", "10"), "events": ("news", "events")}
    assert keys(["state"], None) == {"state": ("state", "10")}
    with pytest.raises(NotCarried, match="'raw': not from afar; there are: state, status"):
        keys(["state", "raw"], 5.0)


def news(time: float) -> bytes:
    """As a daemon says it."""
    return b'{"parameters":{"dropped":0,"topic":"state","time":%.6f,"sequence":7},"continues":true}' % time


@given(st.floats(0.5, 150.0), st.lists(st.floats(-0.2, 0.2), min_size=300, max_size=300))
def test_as_many_a_second_as_asked_whatever_the_jitter(rate: float, jitter: list[float]) -> None:
    """The robot runs at 100 Hz, which bounds the rate."""
    thinned = TopicRateLimiter("state", rate)
    sent = 100.0 if offered(rate) == "full" else float(offered(rate))
    taken = sum(thinned.takes(news(100.0 + (place + late) / sent)) for place, late in enumerate(jitter))
    expected = min(rate, sent) * len(jitter) / sent
    assert 0.95 * expected - 2.0 <= taken <= expected + 2.0


@pytest.mark.parametrize("rate", [10.0, 30.0, 100.0, 500.0])
def test_a_subscriber_at_the_full_rate_receives_every_message(rate: float) -> None:
    thinned = TopicRateLimiter("state", rate)
    sent = min(rate, 100.0)
    assert all(thinned.takes(news(place / sent)) for place in range(1000))


def test_after_a_gap_nothing_is_made_up_for() -> None:
    thinned = TopicRateLimiter("state", 2.0)
    assert [thinned.takes(news(now)) for now in (10.0, 10.2, 70.0)] == [True, False, True]
    assert not [now for now in (70.2, 70.3) if thinned.takes(news(now))]


def test_a_robot_with_a_restarted_clock_is_received_at_once() -> None:
    thinned = TopicRateLimiter("state", 2.0)
    assert thinned.takes(news(5000.0)) and thinned.takes(news(3.0)) and not thinned.takes(news(3.1))


def test_topics_without_a_rate_and_messages_without_a_time_pass_unlimited() -> None:
    events = TopicRateLimiter("events", 1.0)
    states = TopicRateLimiter("state", 2.0)
    assert all(events.takes(news(1.0)) for _ in range(100))
    assert all(states.takes(b"rubbish") for _ in range(100))
