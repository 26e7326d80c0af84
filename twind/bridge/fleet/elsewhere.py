"""The robots that one session of Zenoh reaches: found by their tokens, all asked by one question."""

import json
import time
from typing import Any

import zenoh

from twind.bridge.fleet.reach import ALIVE
from twind.bridge.fleet.roll import UPLINK, Roll
from twind.bridge.zenoh.keys import ROOT, robot_of

PATIENCE = 5.0  # s for an answer
QUESTION = f"{ROOT}/*/ask/GetStatus"
GONE = "its uplink ended, or the way to it is lost"


class Elsewhere:
    """Keeps the roll: who comes and goes by itself, what they say whenever it is told to ask."""

    def __init__(self, roll: Roll, session: zenoh.Session) -> None:
        """Of the session, which whoever opened it ends."""
        self._roll, self._session = roll, session
        self._tokens = session.liveliness().declare_subscriber(
            f"{ROOT}/*/{ALIVE}", self._changed, history=True
        )

    def close(self) -> None:
        """Hear no more of them."""
        self._tokens.undeclare()

    def ask(self) -> None:
        """Everybody, by one question. Returns at once."""
        begun = time.monotonic()
        self._session.get(
            QUESTION,
            lambda reply: self._answered(reply, begun),
            target=zenoh.QueryTarget.ALL,
            payload=b'{"joints":true}',
            timeout=PATIENCE,
        )

    def _changed(self, sample: zenoh.Sample) -> None:
        name = robot_of(str(sample.key_expr))
        if sample.kind == zenoh.SampleKind.DELETE:
            self._roll.lost(name, UPLINK, GONE)
        else:
            self._roll.there(name, UPLINK)

    def _answered(self, reply: zenoh.Reply, begun: float) -> None:
        """What cannot be understood says nothing: its robot's age tells."""
        if reply.ok is None:
            return
        now = time.monotonic()
        try:
            name = robot_of(str(reply.ok.key_expr))
            answer: Any = json.loads(bytes(reply.ok.payload))
            self._roll.told(name, UPLINK, answer, now, now - begun)
        except (ValueError, KeyError, TypeError):
            return
