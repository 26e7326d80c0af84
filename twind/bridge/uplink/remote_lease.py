"""Lease of remote clients to send goals, with its expiry. Time is given, s; no I/O. For several threads.

The rules are those of the daemon's own lease (`safety/lease.py`): one holder, a second without a renewal, and
a lapsed lease does not come back. So renewals that were delayed on the way renew nothing.
"""

from __future__ import annotations

import secrets
import threading

from twind.bridge.commands.leased_motions import refusal
from twind.bridge.zenoh.zenoh_keys import LEASE_S
from twind.client.errors import CallError, as_error
from twind.protocol import CONTROL
from twind.robot.finding import ReasonCode
from twind.safety.lease import Lease

CLIENT = 1  # number of every remote holder in the lease; a grant ends the one before


class RemoteLease:
    """Lease with at most one holder, identified by an unguessable token that only the grant contains."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._lease = Lease()
        self._token = ""

    def admits(self, now: float, *, take: bool) -> None:
        """Return if the lease is free or `take` is set. Raises CallError: LeaseHeld."""
        with self._lock:
            owner = self._lease.info(now)
        if owner is not None and not take:
            lease = {"holder": owner.holder, "uid": owner.uid, "expires_in": owner.expires_in}
            raise as_error(f"{CONTROL}.LeaseHeld", {"lease": lease})

    def grant(self, holder: str, now: float) -> dict[str, object]:
        """Grant the lease to `holder`, even if another holds it. Return the Grant."""
        with self._lock:
            self._lease.release(CLIENT)
            self._token = secrets.token_urlsafe(16)
            self._lease.acquire(CLIENT, holder, -1, now)
        return self.granted(now)

    def renew(self, token: str, now: float) -> dict[str, object]:
        """Renew the lease; return the Grant. Raises CallError: LEASE_MISSING."""
        with self._lock:
            renewed = token == self._token and self._lease.renew(CLIENT, now)
        if not renewed:
            raise missing()
        return self.granted(now)

    def holds(self, token: str, now: float) -> bool:
        """Return True if this token holds the lease now."""
        with self._lock:
            return bool(token) and token == self._token and self._lease.holds(now)

    def is_held(self, now: float) -> bool:
        """Return True if the lease is held now."""
        with self._lock:
            return self._lease.holds(now)

    def end(self) -> None:
        """End the lease: no token holds it any more."""
        with self._lock:
            self._lease.release(CLIENT)
            self._token = ""

    def granted(self, now: float) -> dict[str, object]:
        """Return the Grant as it stands."""
        with self._lock:
            owner = self._lease.info(now)
            holder, left = ("", 0.0) if owner is None else (owner.holder, owner.expires_in)
            return {"lease": self._token, "holder": holder, "expires_in": left, "now": now}


def missing() -> CallError:
    """Return the refusal of a client that does not hold the lease."""
    message = f"this lease is not held: it lapses {LEASE_S:g} s after its last renewal, and may be taken"
    return refusal(ReasonCode.LEASE_MISSING, message)
