"""Which news of a robot are heard from afar, and how many of them. Pure."""

from twind.bridge.zenoh.keys import RATES, TOPICS
from twind.client import NotCarried

USUAL = {"state": 10.0, "latency": 10.0, "status": 2.0}  # Hz where nobody says, as Monitor has them
SLACK = 0.5  # of the time between two that are sent: by how much one may come too early


def keys(topics: list[str], rate: float | None) -> dict[str, tuple[str, ...]]:
    """Chunks of the key of each topic. States come at the next rate above `rate`, Hz. Raises NotCarried."""
    known = ("state", *TOPICS)
    for topic in topics:
        if topic not in known:
            raise NotCarried(f"topic {topic!r}: not from afar; there are: {', '.join(known)}")
    return {topic: ("state", offered(rate)) if topic == "state" else ("news", topic) for topic in topics}


def offered(rate: float | None) -> str:
    """The slowest of the rates that are sent that is not below `rate`, Hz."""
    asked = rate or USUAL["state"]
    return next((each for each in RATES if each != "full" and float(each) >= asked), "full")


class Thinned:
    """Lets through as many a second as were asked for, of a topic that has a rate; of others all."""

    def __init__(self, topic: str, rate: float | None) -> None:
        self._period = self._slack = 0.0  # s
        self._due: float | None = None
        asked, sent = rate or USUAL.get(topic, 0.0), _sent(topic, rate)
        if sent is None or asked < sent:
            self._period = 1.0 / asked
            self._slack = SLACK / sent if sent else 0.0

    def takes(self, now: float) -> bool:
        """It is time for one. `now`: s, monotonic."""
        if self._due is not None and now + self._slack < self._due:
            return False
        self._due = max(now if self._due is None else self._due, now - self._slack) + self._period
        return True


def _sent(topic: str, rate: float | None) -> float | None:
    """Hz at which a topic comes, 0: whenever there is something, None: at the loop's rate."""
    if topic != "state":
        return USUAL.get(topic, 0.0)
    chosen = offered(rate)
    return None if chosen == "full" else float(chosen)
