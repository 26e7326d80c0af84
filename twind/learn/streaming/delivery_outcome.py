"""Meaning of an endpoint's answer for the message, and the delay before the next try. Pure."""

import random
from dataclasses import dataclass
from email.utils import parsedate_to_datetime
from enum import Enum

# s, of the waits that double
FIRST = 0.25
LONGEST = 10.0
PATIENT = 900.0  # s: the longest delay, whatever Retry-After requests
# The connection or the permission is wrong, not the message: it waits until an operator mends that.
NOT_THE_MESSAGE = frozenset({401, 402, 403, 404, 405, 407, 408, 409, 421, 423, 425, 426, 429, 451})


class DeliveryOutcome(Enum):
    """Outcome of a message that was answered."""

    DONE = "done"  # it arrived
    AGAIN = "again"  # the same, later
    DEAD = "dead"  # it will never be taken: a dead letter


def fate(status: int) -> DeliveryOutcome:
    """Return the outcome for a status code.

    A redirection is not followed: where the endpoint has moved, the URL must be changed.
    """
    if 200 <= status < 300:
        return DeliveryOutcome.DONE
    return (
        DeliveryOutcome.DEAD
        if 400 <= status < 500 and status not in NOT_THE_MESSAGE
        else DeliveryOutcome.AGAIN
    )


def retry_after(header: str | None, wall: float) -> float:
    """Return the seconds that the answer requests as a delay, given as seconds or a date.

    Zero for no request, and for a value that is neither.
    """
    if header is None:
        return 0.0
    text = header.strip()
    if text.isascii() and text.isdigit():
        return min(float(text[:9]), PATIENT)
    try:
        return min(max(0.0, parsedate_to_datetime(text).timestamp() - wall), PATIENT)
    except (ValueError, OverflowError, TypeError, IndexError):
        return 0.0


@dataclass(slots=True)
class DeliveryBackoff:
    """Time of the next try: each failure in a row doubles the delay, less a random half."""

    random: random.Random
    failures: int = 0  # in a row
    until: float = 0.0  # s, monotonic

    def failed(self, now: float, asked: float = 0.0) -> None:
        """Once more; `asked`: s of Retry-After, waited for at least."""
        wait = min(LONGEST, FIRST * 2.0 ** min(self.failures, 20)) * self.random.uniform(0.5, 1.0)
        self.failures += 1
        self.until = now + max(wait, asked)

    def went_well(self) -> None:
        """The next failure is the first one again."""
        self.failures = 0
        self.until = 0.0
