"""Setpoints after another client has stopped the stream."""

import pytest

from twind.robot.finding import ReasonCode
from twind.safety.stopped_stream import PAUSE, StoppedStream

STREAMER = 3
OTHER = 4
THIRD = 5


def stopped(by: int, after: float = 0.0) -> StoppedStream:
    """A stream of `STREAMER` that `by` stopped at 10 s, `after` s after its last setpoint."""
    stream = StoppedStream()
    stream.accept(STREAMER, 10.0 - after)
    stream.stop(by, 10.0)
    return stream


def test_setpoints_are_refused_until_a_pause_counted_from_the_last_one() -> None:
    stream = stopped(by=OTHER)
    for now in (10.01, 10.4, 10.8):
        found = stream.refusal(STREAMER, now)
        assert found is not None and (found.code, found.bound) == (ReasonCode.STREAM_STOPPED, PAUSE)
    assert stream.refusal(STREAMER, 10.8 + PAUSE) is None
    assert stream.refusal(STREAMER, 10.9 + PAUSE) is None


@pytest.mark.parametrize(("after", "refused"), [(0.3, True), (0.49, True), (PAUSE, False)])
def test_a_stream_that_is_late_at_the_stop_is_stopped_too(after: float, refused: bool) -> None:
    assert (stopped(OTHER, after).refusal(STREAMER, 10.01) is not None) == refused


def test_half_a_second_without_a_setpoint_ends_the_refusal() -> None:
    assert stopped(by=OTHER).refusal(STREAMER, 10.5) is None
    assert stopped(by=OTHER).refusal(STREAMER, 10.499) is not None


def test_another_client_may_stream_at_once() -> None:
    assert stopped(by=OTHER).refusal(OTHER, 10.01) is None


def test_a_client_that_stops_its_own_stream_may_begin_another_one_at_once() -> None:
    assert stopped(by=STREAMER).refusal(STREAMER, 10.01) is None


def test_a_client_that_stops_too_has_noticed() -> None:
    stream = stopped(by=OTHER)
    stream.stop(STREAMER, 10.1)
    assert stream.refusal(STREAMER, 10.2) is None


def test_each_stopped_client_is_refused_whatever_the_next_streamer_does() -> None:
    stream = stopped(by=OTHER)
    stream.accept(THIRD, 10.1)
    stream.stop(OTHER, 10.2)
    stream.stop(THIRD, 10.3)
    assert stream.refusal(THIRD, 10.31) is None
    assert stream.refusal(STREAMER, 10.31) is not None


def test_a_stop_before_any_stream_bans_no_one() -> None:
    stream = StoppedStream()
    stream.stop(OTHER, 10.0)
    assert stream.refusal(STREAMER, 10.01) is None
    assert stream.refusal(0, 10.01) is None
