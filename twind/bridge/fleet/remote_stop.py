"""Stop of a remote robot: sent whether the robot was seen or not, and repeated until it was done."""

from collections.abc import Mapping
from typing import Any

from twind.bridge.fleet.client_reply_queue import ClientReplyQueue
from twind.bridge.fleet.robot_endpoint import RemoteRobotEndpoint, error_name

AGAIN = 0.1  # s from a stop without success to the next: a lost message must not leave the robot moving
LASTING = 3.0  # s for which it is repeated
FINAL = ("NotAllowed", "InvalidParameter")  # errors that a repetition cannot change


class RemoteStop:
    """Remote stop, with its answer in the inbox. A robot that receives it twice stops once."""

    def __init__(
        self,
        reach: RemoteRobotEndpoint,
        method: str,
        parameters: Mapping[str, Any],
        inbox: ClientReplyQueue,
        now: float,
    ) -> None:
        """Send the stop. `now`: s, monotonic."""
        self._reach = reach
        self._inbox = inbox
        self._parts = ("stop", method)
        self._parameters = parameters
        self._begun = now
        self._open = True  # a query is under way
        self._refusal = b""  # the last error that a repetition may change
        self.over = False
        self._ask()

    def close(self) -> None:
        """Do nothing: a stop holds no lease."""

    def poll(self, now: float) -> float:
        """Repeat a stop that was not done; return the time (s) to the next poll."""
        if not self._open:
            if now - self._begun <= LASTING:
                self._ask()
            else:
                self._give_up()
        return AGAIN

    def _ask(self) -> None:
        self._open = True
        self._reach.ask(
            self._parts, self._parameters, LASTING, self._answered, self._on_silence, all_robots=True
        )

    def _give_up(self) -> None:
        self.over = True
        if self._refusal:
            self._inbox.answer(self._refusal)
        else:
            parts = "/".join(self._parts)
            self._inbox.end(
                f"{self._reach.robot}: no answer to {parts}: it is absent, or this client is not permitted"
            )

    def _answered(self, message: bytes) -> None:
        """Process an answer of any uplink: the first success counts, and no error before it."""
        if self.over:
            return
        if _final(message):
            self.over = True
            self._inbox.answer(message)
        else:
            self._refusal = message
            self._open = False

    def _on_silence(self) -> None:
        self._open = False


def _final(message: bytes) -> bool:
    """Return True if the stop was done, or never will be."""
    name = error_name(message)
    return name == "" or name in FINAL
