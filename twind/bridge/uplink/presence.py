"""The robot's name on the network: claimed before anything is served, and held by one uplink."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import zenoh

from twind.bridge.zenoh.keys import robot_key
from twind.ctl.verb import Rejected

ASK = 2.0  # s that the network has to say who is there


class Presence:
    """A name that is free, claimed from `claim` to `close`.

    Two of one name (a copied memory card) must not both be sent a goal. Who comes second is refused. Who
    finds another later, because both came at once or two networks were joined, gives way if its session's id
    is the larger: `lost` is called, once, with what to say.
    """

    def __init__(self, session: zenoh.Session, robot: str, lost: Callable[[str], None]) -> None:
        """Raises Rejected: the name is taken."""
        self._robot, self._lost = robot, lost
        self._living, self._here = session.liveliness(), str(session.zid())
        self._told = threading.Event()
        self._claims: list[Any] = []  # tokens and a subscriber
        self._alive = robot_key(robot, "alive")
        if any(reply.ok is not None for reply in self._living.get(self._alive, timeout=ASK)):
            raise Rejected(f"{self._taken}; name this one with --name, or end the other")

    def claim(self) -> None:
        """From now on the robot is there, for all to see."""
        for key in (f"{self._alive}/{self._here}", self._alive):
            self._claims.append(self._living.declare_token(key))
        others = self._living.declare_subscriber(f"{self._alive}/*", self._seen, history=True)
        self._claims.append(others)

    def close(self) -> None:
        """Give the name back. May be called twice."""
        while self._claims:
            self._claims.pop().undeclare()

    @property
    def _taken(self) -> str:
        return f"robot {self._robot!r} is alive on this network already"

    def _seen(self, sample: zenoh.Sample) -> None:
        other = str(sample.key_expr).rpartition("/")[2]
        if sample.kind is zenoh.SampleKind.PUT and other < self._here and not self._told.is_set():
            self._told.set()
            self._lost(f"{self._taken}, by another uplink: this one ends; name one of them with --name")
