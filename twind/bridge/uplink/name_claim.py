"""Claim of the robot's name on the network: made before anything is served, and held by one uplink."""

from __future__ import annotations

import threading

import zenoh

from twind.bridge.zenoh.zenoh_keys import robot_key
from twind.command_line.verb import Rejected

ASK = 1.0  # s that the network has to answer
LOOK = 2.0  # s between two queries for other holders of the name


class NameClaim:
    """Claim of a free name, from `claim` to `close`. `rival`: why it belongs to another uplink now.

    Two robots of one name (a copied memory card) must not both receive a goal. The second one is refused. If
    both came at once or two networks were joined, the one with the larger session id gives way. This is
    checked repeatedly: of two tokens declared at the same moment a subscriber with history sometimes misses
    one (2 of 12 in Zenoh 1.10.2), a query does not.
    """

    def __init__(self, session: zenoh.Session, robot: str) -> None:
        """Check the name. Raises Rejected: it is taken."""
        self._robot = robot
        self.rival = ""
        self._living = session.liveliness()
        self._here = str(session.zid())
        self._claims: list[zenoh.LivelinessToken] = []
        self._look_at = 0.0
        self._alive = robot_key(robot, "alive")
        if self._is_there():
            raise Rejected(f"{self._rival_text}; name this one with --name, or end the other")

    def claim(self) -> None:
        """Announce the robot on the network."""
        for key in (f"{self._alive}/{self._here}", self._alive):
            self._claims.append(self._living.declare_token(key))

    def look(self, now: float) -> None:
        """Query other holders of the name, when it is due. `now`: s, monotonic. Does not wait."""
        if now >= self._look_at:
            self._look_at = now + LOOK
            self._living.get(f"{self._alive}/*", self._seen, timeout=ASK)

    def close(self) -> None:
        """Give the name back. May be called twice."""
        while self._claims:
            self._claims.pop().undeclare()

    def _is_there(self) -> bool:
        """Return True if another uplink has the name."""
        found: list[zenoh.Reply] = []
        over = threading.Event()
        self._living.get(self._alive, zenoh.handlers.Callback(found.append, over.set), timeout=ASK)
        over.wait(2.0 * ASK)  # the engine ends the query after ASK; the rest covers a busy machine
        return any(reply.ok is not None for reply in found)

    @property
    def _rival_text(self) -> str:
        return f"robot {self._robot!r} is alive on this network already"

    def _seen(self, reply: zenoh.Reply) -> None:
        if reply.ok is not None and str(reply.ok.key_expr).rpartition("/")[2] < self._here:
            self.rival = f"{self._rival_text}, by another uplink: this one ends; name one of them with --name"
