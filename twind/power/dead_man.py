"""Decision whether the supply relay is closed, from time and the loop's heartbeat. Pure."""

from math import inf


class DeadMan:
    """Relay of one loop: closed while the loop beats and asks for it.

    After a missed beat it stays open until the loop has asked for an open relay.
    """

    def __init__(self, timeout: float) -> None:
        """`timeout`: s without a beat after which the relay opens."""
        self.tripped = False  # opened for want of a beat; the loop has to ask for open before it closes again
        self._timeout = timeout
        self._beat = 0
        self._beat_at = -inf  # s, when the last beat was seen
        self._closed = False

    def is_closed(self, beat: int, wanted: bool, now: float) -> bool:
        """Return whether the relay is to be closed now. `beat`: any number that changes with each tick."""
        if beat != self._beat:
            self._beat = beat
            self._beat_at = now
        in_time = now - self._beat_at <= self._timeout
        self.tripped = (self.tripped and wanted) or (self._closed and not in_time)
        self._closed = wanted and in_time and not self.tripped
        return self._closed
