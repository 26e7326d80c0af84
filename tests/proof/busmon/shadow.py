"""State of the servos of a bus, derived from the bytes alone. Arrays (m,) in order of their ids."""

from collections import deque

import numpy as np

from tests.proof.busmon.limits import Limits

FRESH = 0.05  # s, the oldest position that a goal at torque-on may rest on
NEAR = 2  # counts from it
RECENT = 64  # goal packets that are kept


class Servos:
    """Goals, torque, watchdogs and positions as they went by."""

    def __init__(self, limits: Limits) -> None:
        servos = [limits.servos[id] for id in sorted(limits.servos)]
        count = len(servos)
        self.ids = [servo.id for servo in servos]
        self.row = {id: row for row, id in enumerate(self.ids)}
        self.all = np.arange(count)
        self.lower = np.array([servo.lower for servo in servos], np.int64)
        self.upper = np.array([servo.upper for servo in servos], np.int64)
        self.step = np.array([servo.speed * limits.period + 1.0 + 1e-6 for servo in servos])
        self.brake = np.array([servo.brake * limits.period**2 for servo in servos])  # counts a period, each
        self.goal = np.zeros(count, np.int64)
        self.known = np.zeros(count, np.bool_)  # a goal has gone out
        self.begun(0.0)

    def begun(self, now: float) -> None:
        """A talker that is new on this bus: what it has not read or written itself does not count for it."""
        del now
        count = len(self.ids)
        self.anew = np.ones(count, np.bool_)  # its next goal is where the servo is (W4)
        self.on = np.zeros(count, np.bool_)  # torque it has switched on, and not off again
        self.lost = np.zeros(count, np.bool_)  # torque it has switched on, and read off since
        self.off = np.zeros(count, np.bool_)  # torque it knows to be off: switched off, or read off
        self.first = np.zeros(count, np.bool_)  # no goal has gone out since torque-on
        self.watchdog = np.full(count, -1, np.int64)  # as it wrote it
        self.proved = np.zeros(count, np.bool_)  # and read it back
        self.bare = np.full(count, np.inf)  # s, when its watchdog was switched off under torque
        self.alert = np.zeros(count, np.bool_)
        self.seen: deque[tuple[float, np.ndarray, np.ndarray]] = deque()  # time, rows, positions
        self.goals: deque[tuple[float, np.ndarray, np.ndarray]] = deque(maxlen=RECENT)  # time, goals, moves

    def at(self, now: float, rows: np.ndarray, positions: np.ndarray) -> None:
        """Positions were read."""
        seen = self.seen
        seen.append((now, rows, positions))
        while seen[0][0] < now - 2.0 * FRESH:
            seen.popleft()

    def present(self, row: int, now: float) -> list[int]:
        """Fresh positions of that servo, each moved to the nearest place inside its range."""
        found = []
        for time, rows, positions in reversed(self.seen):
            if time < now - FRESH - 1e-9:
                break
            if rows is self.all:
                found.append(int(positions[row]))
            else:
                found += [int(positions[each]) for each in np.flatnonzero(rows == row)]
        lower = int(self.lower[row])
        upper = int(self.upper[row])
        return found + [min(max(place, lower), upper) for place in found if not lower <= place <= upper]

    def is_here(self, row: int, goal: int, now: float) -> bool:
        """That goal is where the servo is."""
        return any(abs(goal - place) <= NEAR for place in self.present(row, now))

    def aimed_anew(self, rows: list[int], now: float) -> None:
        """The servos of `rows` had dropped their goals: who is aimed where it is makes no step from there.

        W6 then counts from where it was read, if that is nearer than the old goal.
        """
        _, goals, moves = self.goals[-1]
        for row in rows:
            steps = [int(goals[row]) - place for place in self.present(row, now)]
            near = [step for step in steps if abs(step) <= NEAR]
            moves[row] = min([int(moves[row]), *near], key=abs)

    def aim(self, now: float, goals: np.ndarray) -> None:
        """All goals after a packet."""
        moves = goals - self.goal
        self.goal = goals
        self.goals.append((now, goals, moves))
