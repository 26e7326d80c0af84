"""Setpoints after another client has stopped the stream."""

from twind.robot.finding import ReasonCode
from twind.safety.stopped_stream import PAUSE, StoppedStream

STREAMER = 3
OTHER = 4


def stopped(by: int) -> StoppedStream:
    """A stream of `STREAMER` that `by` stopped at 10 s."""
    stream = StoppedStream()
    stream.accept(STREAMER)
    stream.stop(by, True, 10.0)
    return stream


def test_setpoints_are_refused_until_a_pause_counted_from_the_last_one() -> None:
    stream = stopped(by=OTHER)
    for now in (10.01, 10.4, 10.8):
        found = stream.refusal(STREAMER, now)
        assert found is not None and (found.code, found.bound) == (ReasonCode.STREAM_STOPPED, PAUSE)
    assert stream.refusal(STREAMER, 10.8 + PAUSE) is None
    assert stream.refusal(STREAMER, 10.9 + PAUSE) is None


def test_another_client_may_stream_at_once() -> None:
    assert stopped(by=OTHER).refusal(OTHER, 10.01) is None


def test_a_client_that_stops_its_own_stream_may_begin_another_one_at_once() -> None:
    assert stopped(by=STREAMER).refusal(STREAMER, 10.01) is None


def test_a_client_that_stops_too_has_noticed() -> None:
    stream = stopped(by=OTHER)
    stream.stop(STREAMER, False, 10.1)
    assert stream.refusal(STREAMER, 10.2) is None


def test_a_stop_while_nothing_streams_bans_no_one() -> None:
    stream = StoppedStream()
    stream.accept(STREAMER)
    stream.stop(OTHER, False, 10.0)
    assert stream.refusal(STREAMER, 10.01) is None
