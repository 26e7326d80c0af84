"""Orders of faults on the next messages of a virtual bus: serial answers and CAN frames alike."""

from math import isfinite

MOST_DELAY = 10.0  # s


class FaultOrders:
    """Faults of the next messages. A count is of messages to come, of one id or (None) of any.

    Of each fault there is one order at a time per id; a new one replaces it, a count of 0 removes it.
    """

    def __init__(self) -> None:
        self._orders: dict[tuple[str, int | None], tuple[int, float]] = {}  # messages left, value
        self._late: dict[int | None, float] = {}  # id -> s
        self.active = False  # True if messages are processed one by one

    def drop(self, count: int, id: int | None = None) -> None:
        """Lose the next messages. Raises ValueError below 0, KeyError for an id that is not there."""
        self._order("drop", count, id)

    def duplicate(self, count: int, id: int | None = None) -> None:
        """Send each of the next messages twice. Raises ValueError, KeyError."""
        self._order("duplicate", count, id)

    def foreign(self, count: int, id: int | None = None) -> None:
        """Send a valid message of an unknown device before each of the next ones."""
        self._order("foreign", count, id)

    def require(self, id: int) -> None:
        """Check that a device has this id. Raises KeyError."""
        raise NotImplementedError

    def look(self) -> None:
        """Update whether any message is to be changed. To call after every change."""
        self._orders = {key: value for key, value in self._orders.items() if value[0] > 0}
        self.active = bool(self._orders or any(self._late.values()))

    def clear(self) -> None:
        """Remove all faults of messages."""
        self._orders.clear()
        self._late.clear()
        self.look()

    def _order(self, name: str, count: int, id: int | None, value: float = 0.0) -> None:
        if count < 0:
            raise ValueError(f"{name}: {count} messages: a count is 0 or more")
        if not isfinite(value):
            raise ValueError(f"{name}: {value} is not a number")
        if id is not None:
            self.require(id)
        self._orders[name, id] = (count, value)
        self.look()

    def _delay(self, seconds: float, id: int | None) -> None:
        if not 0.0 <= seconds <= MOST_DELAY:
            raise ValueError(f"delay: {seconds} s is outside 0..{MOST_DELAY:g} s")
        if id is not None:
            self.require(id)
        self._late[id] = seconds
        self.look()

    def _hit(self, name: str, id: int) -> float | None:
        """Return the value of an order for this message and use it up; None: there is none."""
        for key in ((name, id), (name, None)):
            count, value = self._orders.get(key, (0, 0.0))
            if count > 0:
                self._orders[key] = (count - 1, value)
                return value
        return None
