"""Calls that the loop leaves unanswered: each is answered once, also where one answer ends the connection."""

from twind.front.client_calls import Caller, ClientCall, ConnectionCalls
from twind.front.joint_naming import JointNames
from twind.front.ticket_table import PATIENCE_BY_METHOD, TicketTable
from twind.protocol import CONTROL


def test_an_answer_that_ends_its_connection_takes_the_other_late_calls_of_it_along() -> None:
    table = TicketTable(JointNames(["hip"]), 0)
    sent: list[bytes] = []

    def broken_pipe(data: bytes) -> None:
        sent.append(data)
        gone.clear()
        table.forget(1)

    gone = ConnectionCalls(Caller(1, "operator", 0, 1), broken_pipe, lambda call: table.open(call, 0.0))
    other = ConnectionCalls(Caller(2, "operator", 0, 1), sent.append, lambda call: table.open(call, 0.0))
    for calls in (gone, gone, other):
        calls.add(ClientCall(calls, CONTROL, "EStop", {}, more=False, oneway=False))
    assert table.expire(PATIENCE_BY_METHOD["EStop"] + 0.1) == ["EStop", "EStop"]
    assert len(sent) == 2
    assert not table.expire(100.0)
