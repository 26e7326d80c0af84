"""A stop from afar: sent whether the robot was seen or not, and again while nobody answers."""

from collections.abc import Mapping
from typing import Any

from twind.bridge.fleet.inbox import Inbox
from twind.bridge.fleet.reach import Reach

AGAIN = 0.1  # s from a question that nobody took to the next
LASTING = 3.0  # s for which it is asked again


class Stop:
    """The answer goes into the inbox. A robot that hears it twice stops once."""

    def __init__(
        self, reach: Reach, method: str, parameters: Mapping[str, Any], inbox: Inbox, now: float
    ) -> None:
        """Sends it. `now`: s, monotonic."""
        self._reach, self._inbox = reach, inbox
        self._parts, self._parameters = ("stop", method), parameters
        self._begun, self._silent = now, False
        self.over = False
        self._ask()

    def close(self) -> None:
        """Nothing is to be given back."""

    def tend(self, now: float) -> float:
        """Ask again where nobody answered; s until the next look."""
        if self._silent:
            if now - self._begun > LASTING:
                self.over = True
                parts = "/".join(self._parts)
                self._inbox.end(
                    f"{self._reach.robot}: nobody answers {parts}: it is not there, or this is not for us"
                )
            else:
                self._ask()
        return AGAIN

    def _ask(self) -> None:
        self._silent = False
        self._reach.ask(self._parts, self._parameters, LASTING, self._answered, self._unheard)

    def _answered(self, message: bytes) -> None:
        self.over = True
        self._inbox.answer(message)

    def _unheard(self) -> None:
        self._silent = True
