"""One robot as one session of Zenoh reaches it: questions, news, and whether it is there."""

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import zenoh

from twind.bridge.zenoh.zenoh_keys import robot_key
from twind.client import Disconnected

Told = Callable[[bytes], None]  # one message of the interface, in a thread of Zenoh's; returns at once
ALIVE = "alive"
_TIMEOUT = b"Timeout"  # what Zenoh itself says in place of an answer


@dataclass(frozen=True, slots=True)
class RemoteRobotEndpoint:
    """`robot` is its name in the key space."""

    session: zenoh.Session
    robot: str

    def ask(
        self,
        parts: tuple[str, ...],
        what: Mapping[str, Any],
        patience: float,
        told: Told,
        silent: Callable[[], None],
        *,
        everybody: bool = False,
    ) -> None:
        """One question. Then either `told` the answer or the error, or `silent`: nobody answered in time.

        `everybody` who serves the key is asked, and each answer told, for one that answers must not keep it
        from the robot; else it is asked of one, and the first answer told.
        """
        heard = False

        def on_reply(reply: zenoh.Reply) -> None:
            nonlocal heard
            message = as_message(reply)
            if message is not None and (everybody or not heard):
                heard = True
                told(message)

        def on_query_end() -> None:
            if not heard:
                silent()

        with self._joined():
            self.session.get(
                robot_key(self.robot, *parts),
                zenoh.handlers.Callback(on_reply, on_query_end),
                payload=json.dumps(what, allow_nan=False, separators=(",", ":")),
                timeout=patience,
                target=zenoh.QueryTarget.ALL if everybody else zenoh.QueryTarget.BEST_MATCHING,
                # By default answers are kept until the last has answered, or hangs.
                consolidation=zenoh.ConsolidationMode.NONE,
            )

    def subscribe_news(
        self, parts: tuple[str, ...], told: Callable[[bytes], None]
    ) -> "zenoh.Subscriber[None]":
        """News, as their bytes, until the subscriber is undeclared."""
        with self._joined():
            return self.session.declare_subscriber(
                robot_key(self.robot, *parts), lambda sample: told(bytes(sample.payload))
            )

    def watch(self, there: Callable[[], None], gone: Callable[[], None]) -> "zenoh.Subscriber[None]":
        """`there`: its uplink is up. `gone`: it ended, or the way there is lost."""

        def on_liveliness(sample: zenoh.Sample) -> None:
            (gone if sample.kind == zenoh.SampleKind.DELETE else there)()

        with self._joined():
            # With history: of a token that a session was never told it is not told the end either.
            return self.session.liveliness().declare_subscriber(
                robot_key(self.robot, ALIVE), on_liveliness, history=True
            )

    @contextmanager
    def _joined(self) -> Iterator[None]:
        """Raises Disconnected: the session was closed, as by whoever shares it."""
        try:
            yield
        except zenoh.ZError as error:
            raise Disconnected(f"{self.robot}: the network was left: {error}") from None


def as_message(reply: zenoh.Reply) -> bytes | None:
    """An answer or an error as a message of the interface; None: nobody answered."""
    if reply.ok is not None:
        return b'{"parameters":%b}' % bytes(reply.ok.payload)
    error = b"" if reply.err is None else bytes(reply.err.payload)
    return None if error == _TIMEOUT else error
