"""Queue of replies for one connection, until they are read. Threads of Zenoh fill it, and never wait."""

import json
import threading
import time
from collections import deque

from twind.client import Disconnected

ROOM = 1 << 20  # bytes of news that may wait


class ClientReplyQueue:
    """Queue of messages as bytes. A full queue drops the oldest news, and counts them, but no answer.

    Answers are few: each is to a query of the reader."""

    def __init__(self, room: int = ROOM) -> None:
        """`room`: bytes of news that may wait."""
        self._room = room
        self._news = 0  # bytes
        self._messages: deque[tuple[bytes, bool]] = deque()  # message, whether it is news
        self._lost = 0  # news dropped since the last one that was read
        self._ended = ""
        self._came = threading.Condition()

    def answer(self, message: bytes) -> None:
        """Add an answer."""
        with self._came:
            self._messages.append((message, False))
            self._came.notify()

    def put_news(self, message: bytes) -> None:
        """Add a news message."""
        with self._came:
            self._messages.append((message, True))
            self._news += len(message)
            while self._news > self._room:
                place = next(place for place, (_, news) in enumerate(self._messages) if news)
                self._news -= len(self._messages[place][0])
                del self._messages[place]
                self._lost += 1
            self._came.notify()

    def end(self, why: str) -> None:
        """End the queue. Messages in it can still be read; the first reason stays."""
        with self._came:
            self._ended = self._ended or why
            self._came.notify()

    def take(self, patience: float) -> bytes | None:
        """Return the next message; None: none within `patience` s. Raises Disconnected."""
        deadline = time.monotonic() + patience
        with self._came:
            while not self._messages:
                left = deadline - time.monotonic()
                if self._ended:
                    raise Disconnected(self._ended)
                if left <= 0.0:
                    return None
                self._came.wait(left)
            return self._next()

    def rest(self) -> list[bytes]:
        """Return all messages in the queue."""
        with self._came:
            return [self._next() for _ in range(len(self._messages))]

    def _next(self) -> bytes:
        message, news = self._messages.popleft()
        if not news:
            return message
        self._news -= len(message)
        lost = self._lost
        self._lost = 0
        return with_lost(message, lost) if lost else message


def with_lost(message: bytes, lost: int) -> bytes:
    """Add the number of lost messages to the `dropped` of a news message.

    Bytes that are no message are returned as they are: the reader reports them.
    """
    try:
        news = json.loads(message)
        news["parameters"]["dropped"] = news["parameters"].get("dropped", 0) + lost
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return message
    return json.dumps(news).encode()
