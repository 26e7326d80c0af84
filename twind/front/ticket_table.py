"""Table of calls that wait for the loop: each has a ticket and a deadline of its answer. Front process."""

from dataclasses import dataclass

from twind.front.client_calls import STOPS, ClientCall
from twind.front.joint_naming import JointNames
from twind.front.state_cache import encode
from twind.link import Reply

PATIENCE = 5.0  # s until the loop must have answered
PATIENCE_BY_METHOD = {
    "Arm": 30.0,
    "Disarm": 30.0,
    "EStop": 30.0,
    "Scan": 60.0,
    "Reboot": 10.0,
    "FindStop": 600.0,
}
BETWEEN = 125.0  # s between two answers to a call with `more`: a start 60 s ahead, then 60 s of motion
OUTSTANDING = 32  # unanswered commands of one connection; only `oneway` can come that far
ESTOPS = 4  # unanswered e-stops of one connection: each has a last answer when the stop ends


@dataclass(slots=True)
class _PendingCall:
    call: ClientCall
    patience: float
    deadline: float


class TicketTable:
    """Commands under way. `first` is the first ticket: no other front may have used it."""

    def __init__(self, names: JointNames, first: int) -> None:
        self._names = names
        self._next = first
        self._waiting: dict[int, _PendingCall] = {}
        self._known_to_loop: set[int] = set()  # connections with a command sent to the loop

    def number(self) -> int:
        """A fresh ticket that is none of a call's."""
        self._next += 1
        return self._next

    def open(self, call: ClientCall, now: float) -> int:
        """A fresh ticket for a call."""
        self._next += 1
        self._known_to_loop.add(call.caller.number)
        patience = PATIENCE_BY_METHOD.get(call.method, PATIENCE)
        self._waiting[self._next] = _PendingCall(call, patience, now + patience)
        return self._next

    def close(self, ticket: int) -> None:
        """The command never left."""
        self._waiting.pop(ticket, None)

    def flooded(self, call: ClientCall) -> bool:
        """Too many commands of this connection are unanswered. A stop is measured by its like only."""
        own = self._own(call)
        if call.method in STOPS:
            own = [other for other in own if other.method == call.method]
        return len(own) >= OUTSTANDING

    def stopping(self, call: ClientCall, level: str) -> bool:
        """Return True if enough e-stops of this connection are unanswered, and one of them requested `level`.

        A level that none of them requested adds to the stop, so it is never one too many.
        """
        levels = [c.parameters.get("level") or "settle" for c in self._own(call) if c.method == call.method]
        return len(levels) >= ESTOPS and level in levels

    def _own(self, call: ClientCall) -> list[ClientCall]:
        number = call.caller.number
        return [w.call for w in self._waiting.values() if w.call.caller.number == number]

    def answer(self, reply: Reply, now: float) -> None:
        """Pass a reply of the loop to its caller, with joints named; late ones are dropped."""
        waiting = self._waiting.get(reply.ticket)
        if waiting is None:
            return
        goes_on = reply.continues and reply.error is None and waiting.call.more
        if goes_on:
            waiting.deadline = now + BETWEEN
        else:
            del self._waiting[reply.ticket]
        named = self._names.reply(reply.parameters)
        if reply.error is not None:
            waiting.call.error(reply.error, named)
        else:
            waiting.call.reply(encode(named), continues=goes_on)

    def expire(self, now: float) -> list[str]:
        """Answer what the loop left unanswered; the methods concerned."""
        late = [ticket for ticket, waiting in self._waiting.items() if now > waiting.deadline]
        methods = []
        for ticket in late:
            waiting = self._waiting.pop(ticket, None)
            if waiting is None:  # the answer before ended its connection
                continue
            methods.append(waiting.call.method)
            text = f"the loop: no answer to {waiting.call.method} within {waiting.patience:g} s; see its log"
            waiting.call.error("Busy", {"what": text})
        return methods

    def forget(self, client: int) -> bool:
        """Void the tickets of a closed connection. Returns True if the loop had a command from it."""
        gone = [ticket for ticket, w in self._waiting.items() if w.call.caller.number == client]
        for ticket in gone:
            del self._waiting[ticket]
        known = client in self._known_to_loop
        self._known_to_loop.discard(client)
        return known
