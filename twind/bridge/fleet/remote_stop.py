"""A stop from afar: sent whether the robot was seen or not, and again until it was done."""

from collections.abc import Mapping
from typing import Any

from twind.bridge.fleet.answers import error_name
from twind.bridge.fleet.outgoing_queue import OutgoingQueue
from twind.bridge.fleet.robot_endpoint import RemoteRobotEndpoint

AGAIN = 0.1  # s from a question that nobody did to the next
LASTING = 3.0  # s for which it is asked again
FINAL = ("NotAllowed", "InvalidParameter")  # errors that asking again changes nothing of


class RemoteStop:
    """The answer goes into the inbox. A robot that hears it twice stops once."""

    def __init__(
        self,
        reach: RemoteRobotEndpoint,
        method: str,
        parameters: Mapping[str, Any],
        inbox: OutgoingQueue,
        now: float,
    ) -> None:
        """Sends it. `now`: s, monotonic."""
        self._reach = reach
        self._inbox = inbox
        self._parts = ("stop", method)
        self._parameters = parameters
        # a question is on its way
        self._begun = now
        self._open = True
        self._refusal = b""  # the last error that asking again may change
        self.over = False
        self._ask()

    def close(self) -> None:
        """Nothing is to be given back."""

    def poll(self, now: float) -> float:
        """Ask again where it was not done; s until the next look."""
        if not self._open:
            if now - self._begun <= LASTING:
                self._ask()
            else:
                self._give_up()
        return AGAIN

    def _ask(self) -> None:
        self._open = True
        self._reach.ask(self._parts, self._parameters, LASTING, self._answered, self._unheard, everybody=True)

    def _give_up(self) -> None:
        self.over = True
        if self._refusal:
            self._inbox.answer(self._refusal)
        else:
            parts = "/".join(self._parts)
            self._inbox.end(
                f"{self._reach.robot}: nobody answers {parts}: it is not there, or this is not for us"
            )

    def _answered(self, message: bytes) -> None:
        """Whoever else answers: the first that did it counts, and no error before it."""
        if self.over:
            return
        if _final(message):
            self.over = True
            self._inbox.answer(message)
        else:
            self._refusal = message
            self._open = False

    def _unheard(self) -> None:
        self._open = False


def _final(message: bytes) -> bool:
    """It was done, or will never be."""
    name = error_name(message)
    return name == "" or name in FINAL
