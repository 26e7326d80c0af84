"""Backlog of a new page: the messages that are left, not every number that was ever given to one.

viser numbers its messages from the start of the server, and a page that connects counts from 0 to the newest
number in one go, in the loop that also serves the stop buttons of all pages. That is 2 s of silence after
10 million messages, which a page that is open for a day causes.
"""

from typing import Any


def shorten_backlog(buffer: Any) -> None:
    """Let pages that connect read viser's `AsyncMessageBuffer` of broadcasts by the messages in it.

    A viser whose buffer works otherwise is left as it is.
    """
    kind = type(buffer)
    if not hasattr(kind, "window_generator") or not hasattr(kind, "_window_loop"):
        return

    def window_generator(client_id: int, backlog_done_message: Any = None) -> Any:
        return kind.window_generator(RenumberedBuffer(buffer), client_id, backlog_done_message)

    buffer.window_generator = window_generator


class RenumberedBuffer:
    """One page's view of a buffer: its messages have the numbers 0, 1, ... without gaps, later ones follow.

    It stands for the buffer, its `message_from_id` and its `generator_cursors`, as far as viser's
    `_window_loop` uses them; everything else is the buffer's own.
    """

    def __init__(self, buffer: Any) -> None:
        self._buffer = buffer
        with buffer.buffer_lock:
            self._left: list[int] = list(buffer.message_from_id)  # the buffer's numbers, ascending
            self._shift: int = buffer.message_counter - len(self._left)
        self.message_from_id = self.generator_cursors = self

    def __getattr__(self, name: str) -> Any:
        return getattr(self._buffer, name)

    def _window_loop(self, *given: Any) -> Any:
        return type(self._buffer)._window_loop(self, *given)

    def _real(self, number: int) -> int:
        """The buffer's number of a message of this page; -1: of none."""
        if number < 0:
            return -1
        return self._left[number] if number < len(self._left) else number + self._shift

    @property
    def message_counter(self) -> int:
        """The number of the next message."""
        count: int = self._buffer.message_counter
        return count - self._shift

    def get(self, number: int, otherwise: Any = None) -> Any:
        """The message with this number, or `otherwise`: it was replaced."""
        return self._buffer.message_from_id.get(self._real(number), otherwise)

    def __setitem__(self, client: int, number: int) -> None:
        """Note the last number that a client has read; -1: none."""
        self._buffer.generator_cursors[client] = self._real(number)

    def pop(self, client: int, otherwise: Any = None) -> Any:
        """Forget a client."""
        return self._buffer.generator_cursors.pop(client, otherwise)
