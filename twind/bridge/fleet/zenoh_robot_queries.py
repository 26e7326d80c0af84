"""Endpoint of one robot in a Zenoh session: queries, news, and its presence."""

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import zenoh

from twind.bridge.zenoh.zenoh_keys import robot_key
from twind.client import Disconnected

TakeMessage = Callable[[bytes], None]  # of the interface, in a thread of Zenoh's; returns at once
ALIVE = "alive"
_TIMEOUT = b"Timeout"  # payload of Zenoh in place of an answer


@dataclass(frozen=True, slots=True)
class RemoteRobotEndpoint:
    """Endpoint of a robot. `robot` is its name in the key space."""

    session: zenoh.Session
    robot: str

    def ask(
        self,
        parts: tuple[str, ...],
        what: Mapping[str, Any],
        patience: float,
        answered: TakeMessage,
        unanswered: Callable[[], None],
        *,
        all_robots: bool = False,
    ) -> None:
        """Send one query. `answered` gets the answer or the error, or `unanswered` is called.

        `all_robots`: query all servers of the key, and pass on each answer. Else query one, and pass on the
        first answer.
        """
        received = False

        def on_reply(reply: zenoh.Reply) -> None:
            nonlocal received
            message = as_message(reply)
            if message is not None and (all_robots or not received):
                received = True
                answered(message)

        def on_query_end() -> None:
            if not received:
                unanswered()

        with self._joined():
            self.session.get(
                robot_key(self.robot, *parts),
                zenoh.handlers.Callback(on_reply, on_query_end),
                payload=json.dumps(what, allow_nan=False, separators=(",", ":")),
                timeout=patience,
                target=zenoh.QueryTarget.ALL if all_robots else zenoh.QueryTarget.BEST_MATCHING,
                # By default answers are kept until the last has answered, or hangs.
                consolidation=zenoh.ConsolidationMode.NONE,
            )

    def silence(self, parts: tuple[str, ...]) -> str:
        """Return why a query without an answer has none."""
        query = "/".join(parts)
        return f"{self.robot}: no answer to {query}: it is absent, or this client is not permitted"

    def subscribe_news(self, parts: tuple[str, ...], on_news: TakeMessage) -> "zenoh.Subscriber[None]":
        """Pass on news, as their bytes, until the subscriber is undeclared."""
        with self._joined():
            return self.session.declare_subscriber(
                robot_key(self.robot, *parts), lambda sample: on_news(bytes(sample.payload))
            )

    def watch(self, there: Callable[[], None], gone: Callable[[], None]) -> "zenoh.Subscriber[None]":
        """Watch the robot. `there`: its uplink is up. `gone`: it ended, or the connection is lost."""

        def on_liveliness(sample: zenoh.Sample) -> None:
            (gone if sample.kind == zenoh.SampleKind.DELETE else there)()

        with self._joined():
            # With history: a session gets no end of a token whose declaration it never received.
            return self.session.liveliness().declare_subscriber(
                robot_key(self.robot, ALIVE), on_liveliness, history=True
            )

    @contextmanager
    def _joined(self) -> Iterator[None]:
        """Return the session. Raises Disconnected: it was closed, as by another user of it."""
        try:
            yield
        except zenoh.ZError as error:
            raise Disconnected(f"{self.robot}: the network was left: {error}") from None


def decoded(message: bytes) -> dict[str, Any]:
    """Return a message as an object; empty: no message."""
    try:
        found = json.loads(message)
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def error_name(message: bytes) -> str | None:
    """Return the error that a message carries, without its interface. "": none; None: no message."""
    found = decoded(message)
    return str(found.get("error") or "").rpartition(".")[2] if found else None


def as_message(reply: zenoh.Reply) -> bytes | None:
    """Return an answer or an error as a message of the interface; None: no answer in time."""
    if reply.ok is not None:
        return b'{"parameters":%b}' % bytes(reply.ok.payload)
    error = b"" if reply.err is None else bytes(reply.err.payload)
    return None if error == _TIMEOUT else error
