"""Subscriber to a robot's state: one connection, read in a thread of its own, that keeps the newest state."""

import threading
import time
from collections.abc import Mapping, Sequence
from typing import Any

from twind.client import Client, ClientError
from twind.robot_client.state_message import StateMessage, decode_state_message

SILENCE = 2.0  # s without a message after which the daemon counts as gone
TOPICS = ("state", "status")
ROW = 20  # states from which one knows how they come
SOON = 2.0  # s within which they do


class StateSubscriber:
    """Listens from `__init__` to `close`. `ended` says why it is over before that.

    One reads while the thread writes: each attribute is replaced whole, never changed.
    """

    def __init__(self, client: Client, joints: Sequence[str], rate_hz: float) -> None:
        """Begin to read. `client` is used by no other code.

        `rate_hz` is the rate of the loop. Raises ClientError.
        """
        client.timeout = SILENCE
        self.newest: StateMessage | None = None
        self.status: Mapping[str, Any] = client.call("GetStatus")["status"]
        self.ended = ""
        self._client = client
        self._joints = tuple(joints)
        self._closing = False
        self._news = threading.Condition()
        stream = client.stream("Monitor", topics=list(TOPICS), rate=rate_hz)
        self._thread = threading.Thread(target=self._listen, args=(stream,), name="senses", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the subscription."""
        self._closing = True
        self._thread.join(SILENCE + 1.0)

    def after(self, sequence: int, until: float) -> StateMessage | None:
        """Return the newest state, once its tick is later than `sequence`.

        None: none came before `until` (s, monotonic).
        """
        with self._news:
            while True:
                now = time.monotonic()
                newest = self.newest
                if newest is not None and newest.sequence > sequence:
                    return newest
                if now >= until or self.ended:
                    return None
                self._news.wait(until - now)

    def next_states(self) -> list[StateMessage]:
        """The next `ROW` states, one after the other; none of them where they do not come."""
        until = time.monotonic() + SOON
        found = list[StateMessage]()
        while len(found) < ROW:
            state = self.after(found[-1].sequence if found else -1, until)
            if state is None:
                return []
            found.append(state)
        return found

    def _listen(self, stream: Any) -> None:
        try:
            for answer in stream:
                arrived = time.monotonic()
                if answer["topic"] == "state":
                    self.newest = decode_state_message(answer, arrived, self._joints)
                    with self._news:
                        self._news.notify_all()
                elif answer["topic"] == "status":
                    self.status = answer["status"]
                if self._closing:
                    break
            else:
                self.ended = "the daemon ended the stream"
        except ClientError as error:
            self.ended = str(error)
        except Exception as error:  # noqa: BLE001  a thread that dies in silence would leave an old state behind
            self.ended = f"a message of the daemon cannot be decoded: {error}"
        finally:
            self._client.close()
            with self._news:
                self._news.notify_all()
