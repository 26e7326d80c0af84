"""Of what a robot says so much is heard as was asked for, from the slowest of its rates that is enough."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.bridge.fleet.news import Thinned, keys, offered
from twind.bridge.zenoh.keys import RATES
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


@given(st.floats(0.5, 9.9), st.lists(st.floats(-0.4, 0.4), min_size=300, max_size=300))
def test_as_many_a_second_as_asked_whatever_the_jitter(rate: float, jitter: list[float]) -> None:
    thinned = Thinned("state", rate)
    sent = float(offered(rate))
    taken = sum(thinned.takes((place + late) / sent) for place, late in enumerate(jitter))
    expected = rate * len(jitter) / sent
    assert 0.95 * expected - 2.0 <= taken <= expected + 2.0


def test_after_a_gap_nothing_is_made_up_for() -> None:
    thinned = Thinned("state", 2.0)
    assert [thinned.takes(now) for now in (0.0, 0.2, 60.0)] == [True, False, True]
    assert not [now for now in (60.2, 60.4) if thinned.takes(now)]


def test_topics_without_a_rate_are_whole() -> None:
    events = Thinned("events", 1.0)
    assert all(events.takes(0.0) for _ in range(100))
