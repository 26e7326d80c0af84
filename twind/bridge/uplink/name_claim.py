"""The robot's name on the network: claimed before anything is served, and held by one uplink."""

from __future__ import annotations

import threading

import zenoh

from twind.bridge.zenoh.zenoh_keys import robot_key
from twind.command_line.verb import Rejected

ASK = 1.0  # s that the network has to say who is there
LOOK = 2.0  # s between two looks who else has the name


class NameClaim:
    """A name that is free, claimed from `claim` to `close`. `rival`: why it is another's now.

    Two of one name (a copied memory card) must not both be sent a goal. Who comes second is refused. Who
    finds another later, because both came at once or two networks were joined, gives way if its session's id
    is the larger. That is asked again and again: of two tokens that are declared at the same moment a
    subscriber with history is now and then not told (2 of 12 in Zenoh 1.10.2), who asks is.
    """

    def __init__(self, session: zenoh.Session, robot: str) -> None:
        """Raises Rejected: the name is taken."""
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
        """From now on the robot is there, for all to see."""
        for key in (f"{self._alive}/{self._here}", self._alive):
            self._claims.append(self._living.declare_token(key))

    def look(self, now: float) -> None:
        """Ask who else has the name, when it is time. `now`: s, monotonic. Waits for nothing."""
        if now >= self._look_at:
            self._look_at = now + LOOK
            self._living.get(f"{self._alive}/*", self._seen, timeout=ASK)

    def close(self) -> None:
        """Give the name back. May be called twice."""
        while self._claims:
            self._claims.pop().undeclare()

    def _is_there(self) -> bool:
        """Somebody has the name."""
        found: list[zenoh.Reply] = []
        over = threading.Event()
        self._living.get(self._alive, zenoh.handlers.Callback(found.append, over.set), timeout=ASK)
        over.wait(2.0 * ASK)
        return any(reply.ok is not None for reply in found)

    @property
    def _rival_text(self) -> str:
        return f"robot {self._robot!r} is alive on this network already"

    def _seen(self, reply: zenoh.Reply) -> None:
        if reply.ok is not None and str(reply.ok.key_expr).rpartition("/")[2] < self._here:
            self.rival = f"{self._rival_text}, by another uplink: this one ends; name one of them with --name"
