"""A script while it runs: its requests, its end, and what is left of its errors."""

from typing import Any

import pytest

from twind.loop.bus.script_run import ScriptRun
from twind_drivers.bus import BusError, PingRequest, RequestReply, Script

REPLY = RequestReply({1: b""}, {1: 0}, 0.001, 0)
LATER = RequestReply({}, {}, 0.002, 3)


def run(script: Script[Any]) -> ScriptRun[Any]:
    """The script at its first request."""
    task = ScriptRun(script)
    assert not task.urgent and not task.done
    task.advance(None)
    return task


def two() -> Script[list[RequestReply]]:
    first = yield PingRequest(1)
    return [first, (yield PingRequest(2))]


def test_each_reply_leads_to_the_next_request_and_the_last_one_to_the_result() -> None:
    task = run(two())
    assert (task.request, task.done) == (PingRequest(1), False)
    task.advance(REPLY)
    assert (task.request, task.done, task.result) == (PingRequest(2), False, None)
    task.advance(LATER)
    assert (task.request, task.done, task.error) == (None, True, None)
    assert task.result == [REPLY, LATER]


@pytest.mark.parametrize("kind", [BusError, KeyError, ValueError])
def test_a_failed_script_keeps_its_error_without_the_frames_that_it_came_from(kind: type[Exception]) -> None:
    error = kind("refused")

    def script() -> Script[None]:
        yield PingRequest(1)
        raise error

    task = run(script())
    task.advance(REPLY)
    assert task.error is error
    assert error.__traceback__ is None
    assert (task.request, task.done, task.result) == (None, True, None)


def test_a_defect_fails_the_tick_and_the_script_counts_as_failed() -> None:
    def script() -> Script[None]:
        yield PingRequest(1)
        raise ZeroDivisionError("a defect")

    task = run(script())
    with pytest.raises(ZeroDivisionError):
        task.advance(REPLY)
    assert isinstance(task.error, BusError)
    assert str(task.error) == "failed inside: ZeroDivisionError('a defect')"
    assert (task.request, task.done) == (None, True)


def test_a_cancelled_script_asks_for_nothing_more_and_is_closed() -> None:
    closed = []

    def script() -> Script[None]:
        try:
            yield PingRequest(1)
        finally:
            closed.append("closed")

    task = run(script())
    why = BusError("the port was lost")
    task.cancel(why)
    task.cancel(BusError("a more urgent script came"))
    assert closed == ["closed"]
    assert (task.request, task.done, task.error) == (None, True, why)


def test_a_script_that_has_ended_is_not_cancelled_any_more() -> None:
    task = run(two())
    task.advance(REPLY)
    task.advance(LATER)
    task.cancel(BusError("too late"))
    assert (task.error, task.result) == (None, [REPLY, LATER])
