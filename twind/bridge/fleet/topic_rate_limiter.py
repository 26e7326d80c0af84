"""Rate limiter of a robot's news for remote clients. Pure."""

import re

from twind.bridge.zenoh.zenoh_keys import RATES, TOPICS
from twind.client import NotCarried

USUAL = {"state": 10.0, "latency": 10.0, "status": 2.0}  # Hz without a requested rate, as in Monitor
SLACK = 0.25  # share of the period by which a message may be early
_TIME = re.compile(rb'"time":(\d+(?:\.\d+)?)')


def keys(topics: list[str], rate: float | None) -> dict[str, tuple[str, ...]]:
    """Chunks of the key of each topic. States come at the next rate above `rate`, Hz. Raises NotCarried."""
    known = ("state", *TOPICS)
    for topic in topics:
        if topic not in known:
            raise NotCarried(f"topic {topic!r}: not from afar; there are: {', '.join(known)}")
    return {topic: ("state", offered(rate)) if topic == "state" else ("news", topic) for topic in topics}


def offered(rate: float | None) -> str:
    """Return the lowest offered rate that is not below `rate`, Hz."""
    requested = rate or USUAL["state"]
    return next((each for each in RATES if each != "full" and float(each) >= requested), "full")


class TopicRateLimiter:
    """Rate limiter of a topic with a rate; other topics pass whole.

    It uses the time stamps of the robot: on the network some messages come late, and others close behind.
    """

    def __init__(self, topic: str, rate: float | None) -> None:
        requested = rate or USUAL.get(topic, 0.0)
        sent = _sent(topic, rate)
        self._period = 1.0 / requested if sent is None or requested < sent else 0.0  # s; 0: all
        # s, the robot's clock
        self._last = 0.0
        self._due = float("-inf")

    def takes(self, message: bytes) -> bool:
        """Return True if a message is due. One without a time passes."""
        stamp = _TIME.search(message, 0, 200) if self._period else None
        if stamp is None:
            return True
        now = float(stamp[1])
        if now < self._last:  # it was started anew
            self._due = float("-inf")
        self._last = now
        if now + SLACK * self._period < self._due:
            return False
        behind = now - self._due > self._period  # a gap: lost messages are not repeated
        self._due = (now if behind else self._due) + self._period
        return True


def _sent(topic: str, rate: float | None) -> float | None:
    """Return the rate (Hz) of a topic; 0: on change; None: the loop's rate."""
    if topic != "state":
        return USUAL.get(topic, 0.0)
    chosen = offered(rate)
    return None if chosen == "full" else float(chosen)
