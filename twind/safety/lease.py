"""Lease: the right to command, held by one connection at a time, until a time.

No clock: `now` is an argument, s monotonic. An unknown or backward time counts as too late. A lease that has
once been found lapsed does not come back.
"""

from dataclasses import dataclass

TRAJECTORY = 1.0  # s that a renewal lasts
STREAMING = 0.25  # s, while setpoints are streamed


@dataclass(frozen=True, slots=True)
class LeaseHolder:
    """Holder of the lease, and the time until it lapses."""

    client: int
    holder: str
    uid: int
    expires_in: float  # s; the full term while a followed trajectory keeps it


class Lease:
    """Lease with at most one holder. `epoch` grows with every change of holder, and never shrinks."""

    def __init__(self) -> None:
        self.epoch = 0
        self._client = 0
        self._name = ""
        self._uid = -1
        self._renewed = 0.0
        self._term = TRAJECTORY
        self._pins: set[str] = set()
        self._seen = 0.0  # s, the last time anybody asked

    def acquire(self, client: int, holder: str, uid: int, now: float, *, take: bool = False) -> bool:
        """Take the lease if it is free or one's own; with `take` from any holder. False: another holds it.

        Clients are numbers above 0; the caller holds the motion before a lease changes hands.
        """
        owner = self.holder_client(now)
        if client <= 0 or (owner not in (0, client) and not take):
            return False
        if owner != client:
            self.epoch += 1
            self._pins = set()
        self._client = client
        self._name = holder
        self._uid = uid
        self._renewed = now
        self._term = TRAJECTORY
        return True

    def renew(self, client: int, now: float, *, streaming: bool = False) -> bool:
        """Begin another term for the holder; False for any other client, and after the lease lapsed."""
        if not self.held_by(client, now):
            return False
        self._renewed = now
        self._term = STREAMING if streaming else TRAJECTORY
        return True

    def release(self, client: int) -> bool:
        """Give the lease back; False when this client did not hold it."""
        if client == 0 or self._client != client:
            return False
        self._drop()
        return True

    def release_client(self, client: int) -> bool:
        """Drop the lease of a connection that closed. True when it had one."""
        return self.release(client)

    def front_lost(self) -> None:
        """Drop the lease: the front process died, and with it every connection."""
        self._drop()

    def pin(self, client: int, name: str) -> None:
        """A followed trajectory of this client is open: it renews the lease by itself."""
        if client != 0 and self._client == client:
            self._pins.add(name)

    def unpin(self, client: int, name: str) -> None:
        """Remove the pin of a trajectory that ended; a last term begins."""
        if client != 0 and self._client == client and name in self._pins:
            self._pins.remove(name)
            self._renewed = self._seen
            self._term = TRAJECTORY

    def holds(self, now: float) -> bool:
        """Somebody holds it now."""
        self._seen = now
        if self._client == 0:
            return False
        if self._pins or 0.0 <= now - self._renewed <= self._term:
            return True
        self._drop()
        return False

    def held_by(self, client: int, now: float) -> bool:
        """This client holds it now (LEASE_MISSING)."""
        return self.holds(now) and self._client == client

    def holder_client(self, now: float) -> int:
        """Number of the client that holds the lease at `now` (s); 0: none."""
        return self._client if self.holds(now) else 0

    def info(self, now: float) -> LeaseHolder | None:
        """Return the holder of the lease at `now` (s); None: it is free or has lapsed."""
        if not self.holds(now):
            return None
        left = self._term if self._pins else self._renewed + self._term - now
        return LeaseHolder(self._client, self._name, self._uid, left)

    def _drop(self) -> None:
        if self._client:
            self.epoch += 1
        self._client = 0
        self._name = ""
        self._uid = -1
        self._pins = set()
