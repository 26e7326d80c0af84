"""Record of the daemon's states of all joints while one joint moves."""

import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from twind.client import Client, ClientError
from twind.robot.arrays import Floats

RATE = 50.0  # Hz
SETTLING = 0.4  # of each stay that is left out at its beginning
PLACE = 1e-3  # rad: closer to a goal than that counts as being told to be there


@dataclass(frozen=True, slots=True)
class HoldMean:
    """Means over a time in which one goal was held. Arrays (n,), NaN without a reading."""

    position: Floats  # rad
    simulated: Floats  # rad
    effort: Floats  # N·m


@dataclass(frozen=True, slots=True)
class MoveHolds:
    """Before the move, at its far end, and home again."""

    before: HoldMean
    out: HoldMean
    home: HoldMean


class StateTrace:
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

    def stays(self, joint: int, home: float, out: float) -> MoveHolds | None:
        """The stays of a joint that went from `home` to `out` (rad) and back; None: it had no such goals."""
        found = self.visits(joint, (home, out, home))
        return None if found is None else MoveHolds(*found)

    def visits(self, joint: int, places: Sequence[float]) -> list[HoldMean] | None:
        """The stays of a joint at each of these places (rad), in this order; None: it had no such goals."""
        goals = np.array([row[3][joint] for row in self.rows])
        found = []
        first = 0
        for place in places:
            away = np.abs(goals - place) >= PLACE
            begun = np.flatnonzero(~away[first:])
            if not len(begun):
                return None
            first += int(begun[0])
            left = np.flatnonzero(away[first:])
            last = first + int(left[0]) if len(left) else len(goals)
            found.append(self._mean(first, last))
            first = last
        return found

    def _mean(self, first: int, last: int) -> HoldMean:
        kept = self.rows[first + int(SETTLING * (last - first)) : last]
        return HoldMean(*(_mean(np.array([row[k] for row in kept])) for k in range(3)))


def _mean(values: Floats) -> Floats:
    """Over the rows of (k, n) that are numbers; NaN (n,) where none is: a reading may get lost."""
    known = np.isfinite(values)
    count = known.sum(axis=0)
    total = np.where(known, values, 0.0).sum(axis=0)
    means: Floats = np.divide(total, count, out=np.full(values.shape[1], np.nan), where=count > 0)
    return means


@contextmanager
def record_states(client: Client, names: Sequence[str]) -> Iterator[StateTrace]:
    """States while the body runs, on a connection of their own. Raises ClientError: none can be had."""
    trace = StateTrace(names)
    ended = threading.Event()
    began = threading.Event()
    client.connect()

    def listen() -> None:
        with suppress(ClientError):  # the other connection reports the end of a daemon
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
