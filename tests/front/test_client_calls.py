"""Answers leave in call order; stopping methods begin at once."""

from collections.abc import Callable

from twind.front.client_calls import PENDING, Caller, ClientCall, ConnectionCalls
from twind.protocol import CONTROL


class Line:
    """A connection's calls, what was sent, and what was begun."""

    def __init__(self, begin: Callable[[ClientCall], None] = lambda call: None) -> None:
        self.sent: list[bytes] = []
        self.begun: list[str] = []
        self._begin = begin
        self.calls = ConnectionCalls(Caller(1, "operator", 0, 1), self.sent.append, self._start)

    def _start(self, call: ClientCall) -> None:
        self.begun.append(call.method)
        self._begin(call)

    def add(self, method: str, *, more: bool = False, oneway: bool = False) -> ClientCall:
        call = ClientCall(self.calls, CONTROL, method, {}, more=more, oneway=oneway)
        self.calls.add(call)
        return call


def test_the_next_call_begins_when_the_one_before_has_ended() -> None:
    line = Line()
    first = line.add("Arm")
    second = line.add("Reset")
    assert line.begun == ["Arm"]
    first.reply(b"1")
    assert line.begun == ["Arm", "Reset"]
    second.reply(b"2")
    assert line.sent == [b'{"parameters":1}', b'{"parameters":2}']
    assert not line.calls


def test_a_stop_begins_at_once_and_its_answer_waits_its_turn() -> None:
    line = Line()
    motion = line.add("SubmitTrajectory", more=True)
    stop = line.add("EStop")
    assert line.begun == ["SubmitTrajectory", "EStop"]
    stop.reply(b"2")
    assert line.sent == []
    motion.reply(b"1", continues=True)
    motion.reply(b"1")
    assert line.sent == [b'{"parameters":1,"continues":true}', b'{"parameters":1}', b'{"parameters":2}']


def test_a_oneway_call_begins_at_once_and_is_never_answered() -> None:
    line = Line()
    line.add("Arm")
    oneway = line.add("Setpoint", oneway=True)
    assert line.begun == ["Arm", "Setpoint"]
    oneway.error("Busy", {})
    assert line.sent == []


def test_without_more_nothing_continues() -> None:
    line = Line()
    call = line.add("Scan")
    call.reply(b"1", continues=True)
    call.reply(b"2")
    assert line.sent == [b'{"parameters":1}']


def test_calls_that_are_answered_at_once_do_not_pile_up() -> None:
    line = Line(lambda call: call.reply(b"{}"))
    for _ in range(5 * PENDING):
        line.add("GetStatus")
    assert len(line.sent) == 5 * PENDING
    assert not line.calls


def test_a_connection_reports_when_its_pending_calls_are_full() -> None:
    line = Line()
    for _ in range(PENDING):
        assert not line.calls.full
        line.add("Arm")
    assert line.calls.full


def test_a_connection_that_ends_within_a_call_ends_quietly() -> None:
    line = Line(lambda call: line.calls.clear())
    call = line.add("GetStatus")
    call.reply(b"{}")
    assert line.sent == []
