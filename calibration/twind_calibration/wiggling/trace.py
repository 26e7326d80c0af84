"""What every joint did while one was moved: the daemon's own states, as they came."""

import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from twind.client import Client, ClientError
from twind.robot.arrays import Bools, Floats

RATE = 50.0  # Hz
SETTLING = 0.4  # of each stay that is left out at its beginning
PLACE = 1e-3  # rad: closer to a goal than that counts as being told to be there


@dataclass(frozen=True, slots=True)
class Stay:
    """Means over a time in which one goal was held. Arrays (n,), NaN where nothing was heard."""

    position: Floats  # rad
    simulated: Floats  # rad
    effort: Floats  # N·m


@dataclass(frozen=True, slots=True)
class Stays:
    """Before the move, at its far end, and home again."""

    before: Stay
    out: Stay
    home: Stay


class Trace:
    """States in the order of their coming."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names = tuple(names)
        self.rows: list[tuple[Floats, ...]] = []  # position, simulated, effort, goal: (n,) each

    def take(self, joints: Sequence[Mapping[str, Any]]) -> None:
        """One message of topic `state`."""
        by_name = {joint["name"]: joint for joint in joints}
        keys = ("position", "simulated", "effort", "goal")
        told = [[by_name[name].get(key) if by_name[name]["heard"] or key == "goal" else None for key in keys]
                for name in self.names]  # fmt: skip
        self.rows.append(tuple(np.array(told, np.float64).T))

    def stays(self, joint: int, home: float, out: float) -> Stays | None:
        """The stays of a joint that went from `home` to `out` (rad) and back; None: it was not told to."""
        if not self.rows:
            return None
        goals = np.array([row[3][joint] for row in self.rows])
        away = np.flatnonzero(np.abs(goals - out) < PLACE)
        if not len(away):
            return None
        near = np.abs(goals - home) < PLACE
        place = np.arange(len(goals))
        parts = (near & (place < away[0]), np.isin(place, away), near & (place > away[-1]))
        if not all(part.any() for part in parts):
            return None
        return Stays(*(self._mean(part) for part in parts))

    def _mean(self, part: Bools) -> Stay:
        rows = np.flatnonzero(part)
        kept = [self.rows[row] for row in rows[int(SETTLING * len(rows)) :]]
        return Stay(*(_mean(np.array([row[k] for row in kept])) for k in range(3)))


def _mean(values: Floats) -> Floats:
    """Over the rows of (k, n) that are numbers; NaN (n,) where none is: a reading may get lost."""
    known = np.isfinite(values)
    count = known.sum(axis=0)
    total = np.where(known, values, 0.0).sum(axis=0)
    means: Floats = np.divide(total, count, out=np.full(values.shape[1], np.nan), where=count > 0)
    return means


@contextmanager
def recorded(client: Client, names: Sequence[str]) -> Iterator[Trace]:
    """States while the body runs, on a connection of their own. Raises ClientError: none can be had."""
    trace, ended, began = Trace(names), threading.Event(), threading.Event()
    client.connect()

    def listen() -> None:
        with suppress(ClientError):  # a daemon that is gone is told by the other connection
            for news in client.stream("Monitor", topics=["state"], rate=RATE):
                trace.take(news["joints"])
                began.set()
                if ended.is_set():
                    break
        client.close()
        began.set()

    listener = threading.Thread(target=listen, daemon=True)
    listener.start()
    try:
        began.wait(client.timeout)
        yield trace
    finally:
        ended.set()
        listener.join(client.timeout)
