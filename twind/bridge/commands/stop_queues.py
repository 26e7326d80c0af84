"""Stops from elsewhere: a queue each for settle, cut and hold, with connections of their own."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Protocol

from twind.bridge.commands.request_queue import PACE, RequestQueue
from twind.client import Client, ClientError, NoDaemon

SETTLE = "settle"
CUT = "cut"
HOLD = "hold"
WAITING = 1024  # requests that one call answers; more get no answer, but the stop is made for them too
PATIENCE = 35.0  # s for an answer; an e-stop answers when its first effect is confirmed, within 30

Connect = Callable[[], Client]
Outcome = Mapping[str, Any] | ClientError
Tell = Callable[[str], None]


class StopRequest(Protocol):
    """Request for a stop."""

    @property
    def parameters(self) -> Mapping[str, Any]:
        """Parameters of the daemon's method."""

    def reply(self, outcome: Outcome) -> None:
        """Take the outcome, in the thread of the queue."""


class StopQueues:
    """Queues of one daemon's stops.

    An e-stop is never refused: not for load, and by no connection alone.
    """

    def __init__(
        self,
        operator: Connect,
        observer: Connect,
        stopped: Callable[[float], None],
        tell: Tell,
        *,
        closed: Callable[[], str] = str,
        hold_pace: float = PACE,
    ) -> None:
        """Make the queues; `stopped` gets the time (s, monotonic) before and after each stop.

        `closed`: why no hold is taken; "": it is. `hold_pace`: s between two holds.
        """
        self._operator = operator
        self._observer = observer
        self._stopped = stopped
        self._closed = closed
        self.queues: Mapping[str, RequestQueue[StopRequest]] = {
            kind: RequestQueue(
                kind,
                partial(self._serve, kind),
                tell,
                length=WAITING,
                pace=hold_pace if kind == HOLD else PACE,
                choose=list,  # all: one call answers them
            )
            for kind in (SETTLE, CUT, HOLD)  # a cut is requested because the robot does not settle
        }

    def put(self, kind: str, request: StopRequest) -> bool:
        """Queue a stop; False: it is made, but its sender gets no answer. Returns at once, from any thread.

        A request that waits already is not queued again.
        """
        self.queues[kind].remove(lambda waiting: waiting is request)
        return self.queues[kind].put(request) is not None

    def _serve(self, kind: str, requests: Sequence[StopRequest]) -> None:
        outcome = self._stop(kind, requests[0].parameters)
        failure: Exception | None = None
        for each in requests:
            try:
                each.reply(outcome)
            except Exception as error:  # noqa: BLE001  the others get their answer
                failure = error
        if failure is not None:
            raise failure

    def _stop(self, kind: str, parameters: Mapping[str, Any]) -> Outcome:
        """Make the stop: no motion that arrived before its answer begins after it."""
        closed = self._closed() if kind == HOLD else ""
        if closed:
            return ClientError(closed)
        self._stopped(time.monotonic())
        try:
            if kind == HOLD:
                return call((self._operator,), "Cancel", PATIENCE, {})
            both = (self._observer, self._operator)  # the one may have no place left, or not answer
            return call(both, "EStop", PATIENCE, {**parameters, "level": kind})
        finally:
            self._stopped(time.monotonic())


def call(connections: Sequence[Connect], method: str, patience: float, given: Mapping[str, Any]) -> Outcome:
    """Return the answer by the first of the connections that has one, else the error of the last.

    Each call has a connection of its own, so that no other call is before it.
    """
    outcome: Outcome = NoDaemon(f"{method}: no connection")
    for connect in connections:
        try:
            with connect() as client:
                client.timeout = patience
                return client.call(method, **given)
        except ClientError as error:
            outcome = error.with_traceback(None)
        except Exception as error:  # noqa: BLE001  the queue of stops must survive any defect
            outcome = ClientError(f"{method}: {type(error).__name__}: {error}")
    return outcome
