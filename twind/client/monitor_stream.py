"""Stream of `Monitor` over restarts of the daemon, and a filter for repeated faults. Standard library."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from twind.client.connection import Client
from twind.client.errors import ClientError

AGAIN = 0.3  # s between two attempts to reach a daemon that ended: a refused connect returns at once


@dataclass(slots=True)
class RepeatedFaultFilter:
    """Reports a fault when it begins and when it is over, not at every retry. `every`: s between two."""

    every: float = 10.0
    wrong: str = ""
    reported: str = ""
    at: float = float("-inf")

    def is_transition(self, wrong: str, now: float) -> bool:
        """True if `wrong` ("": no fault) needs a line now. Alternating reasons get one each `every` s."""
        self.wrong = wrong
        if wrong == self.reported or (wrong and self.reported and now - self.at < self.every):
            return False
        self.reported = wrong
        self.at = now
        return True


def monitor_messages(
    connect: Callable[[], Client], topics: Sequence[str], rate: float, gone: Callable[[str], None]
) -> Iterator[dict[str, Any]]:
    """Yield messages of Monitor without end, over restarts. `gone` gets the reason of each end.

    Blocks. Raises ClientError if the first one cannot be reached or does not answer.
    """
    client = connect()
    answered = False
    while True:
        try:
            with client:
                for message in client.stream("Monitor", topics=list(topics), rate=rate):
                    answered = True
                    yield message
        except ClientError as error:
            if not answered:
                raise
            gone(str(error))
        client = _reconnect(connect)


def _reconnect(connect: Callable[[], Client]) -> Client:
    while True:
        time.sleep(AGAIN)
        try:
            return connect()
        except ClientError:
            continue
