"""Rules about stopping: W6, after an e-stop joints brake and are let go in time; W7, a hold after silence."""

from dataclasses import dataclass
from math import ceil

import numpy as np

from tests.proof.busmon.limits import Limits
from tests.proof.busmon.shadow import Servos
from tests.proof.busmon.words import Broken

SETTLE = 4.0  # s from an e-stop to torque off
ROUNDS = 0.25  # s beside it: torque is written at the end of a tick, and once more
FREE = 5.0  # s more for a robot that stands freely, or whose way down was cut short and said so
CUT = 0.05  # s from an e-stop of level cut to torque off
SHARE = 0.5  # of the acceleration limit: braking is at least so hard ...
LEAD = 2  # ... from the third packet on
ROUNDING = 1.0  # count, by which a step of a goal may be off
HELD = 0.3  # s beside the longest braking, after which a hold must show
STILL = 2  # goal packets in a row without a move: it holds


@dataclass
class Stop:
    """An e-stop under way."""

    level: str
    at: float
    due: float
    speed: np.ndarray  # counts a packet when it was asked for, >= 0
    lasts: np.ndarray  # packets that braking is watched
    rest: np.ndarray  # packet after which a joint was at rest; inf: not yet
    packets: int = 0
    last: float = -np.inf  # s, of the last packet that counted


class Stopping:
    """Joints that must come to rest, and their deadlines."""

    def __init__(self, broken: Broken, limits: Limits, servos: Servos) -> None:
        self._broken = broken
        self._servos = servos
        self._free = limits.support not in ("fixed", "gantry")
        self._period = limits.period
        longest = float((servos.step / servos.brake).max()) * limits.period
        self._hold_within = 2.0 * longest + HELD
        self.clear()

    def clear(self) -> None:
        """Nothing is owed: another process, or no port."""
        self._stop: Stop | None = None
        self._sinks = False  # it is damped, or its way down was cut short
        self._hold_due = np.inf
        self._silence = 0.0
        self._still = 0

    @property
    def easy(self) -> bool:
        return self._stop is None and self._hold_due == np.inf

    def take_report(self, what: str, now: float, facts: dict[str, object]) -> None:
        """Take a report of the daemon; see `Words.take_report`."""
        if what == "hold" or (what == "state" and facts["state"] != "armed"):
            self._hold_due = np.inf
        if what == "state" and facts["state"] == "armed":
            self._sinks = False
        if what in ("damp", "aborted"):
            self._sinks = True
            self._sink(now)
        if what == "killed":
            self.clear()

    def _sink(self, now: float) -> None:
        """Watch no braking of a robot that sinks: its goals follow it, within W3."""
        if self._stop is not None:
            self._stop.due = max(self._stop.due, now + FREE + ROUNDS)
            self._stop.lasts[:] = 0.0

    # --------------------------------------------------------------------------- W6

    def begin(self, level: str, at: float, now: float) -> None:
        """An e-stop was asked for at `at`, which may be a little ago: what left since is judged too."""
        servos = self._servos
        if self._stop is not None and (self._stop.level == "cut" or level != "cut"):
            return
        if not servos.on.any():
            return
        before = [each for each in servos.goals if each[0] < at]
        speed = np.abs(self._move(before)).astype(np.float64)
        lasts = np.ceil(speed / (SHARE * servos.brake)) + LEAD
        due = at + (CUT if level == "cut" else SETTLE + ROUNDS + (FREE if self._free else 0.0))
        if self._stop is not None:
            due = min(due, self._stop.due)
        self._stop = Stop(level, at, due, speed, lasts, np.full(len(speed), np.inf))
        if self._sinks and level != "cut":
            self._sink(now)
        for time, _, moves in [each for each in servos.goals if each[0] >= at]:
            self._brakes(time, moves)

    def _move(self, before: list[tuple[float, np.ndarray, np.ndarray]]) -> np.ndarray:
        """The last step of each joint, were it in the last packets of one tick."""
        if not before:
            return np.zeros(len(self._servos.ids))
        last = before[-1][0]
        tick = [moves for time, _, moves in before if last - time < 0.5 * self._period]
        return np.max(np.abs(tick), axis=0)

    def goals(self, now: float) -> None:
        """A goal packet went out; its moves stand in the servos' history."""
        _, _, moves = self._servos.goals[-1]
        if self._stop is not None:
            self._brakes(now, moves)
        if self._hold_due < np.inf:
            self._still = self._still + 1 if not moves.any() else 0
            if self._still >= STILL:
                self._hold_due = np.inf

    def _brakes(self, time: float, moves: np.ndarray) -> None:
        stop = self._stop
        servos = self._servos
        assert stop is not None
        if stop.level == "cut":
            self._broken("W6", time, None, "a goal after an e-stop that cuts")
            return
        if time - stop.last > 0.5 * self._period:
            stop.packets = stop.packets + 1
            stop.last = time
        braking = np.maximum(stop.speed - SHARE * servos.brake * max(0, stop.packets - LEAD), 0.0)
        # Who brakes harder than it must is lowered earlier, and begins from rest.
        lowered = servos.brake * np.maximum(stop.packets - stop.rest, 0.0)
        fastest = np.maximum(braking, lowered) + ROUNDING
        rests = (np.abs(moves) <= ROUNDING) & (stop.packets >= LEAD)
        stop.rest[rests] = np.minimum(stop.rest[rests], stop.packets)
        wrong = (stop.packets <= stop.lasts) & ~(np.abs(moves) <= fastest + 1e-6)
        if wrong.any():
            row = int(np.argmax(wrong))
            text = f"{ceil(abs(moves[row]))} counts in packet {stop.packets} after the e-stop"
            self._broken("W6", time, servos.ids[row], f"{text}, {fastest[row]:.1f} allowed")

    def let_go(self, now: float) -> None:
        """Torque was switched off somewhere."""
        if not self._servos.on.any():
            self.clear()

    # --------------------------------------------------------------------------- W7, and time

    def owe_hold(self, now: float, silence: float) -> None:
        """Nothing was said for too long: from now on a hold must show."""
        self._silence = max(self._silence, silence)
        if self._hold_due == np.inf:
            self._hold_due = now + self._hold_within
            self._still = 0
            self._silence = silence

    def look(self, now: float) -> None:
        """Report what is overdue."""
        if self._stop is not None and now > self._stop.due:
            on = self._servos.on
            row = int(np.argmax(on))
            text = f"torque still on {now - self._stop.at:.2f} s after the e-stop ({self._stop.level})"
            self._broken("W6", now, self._servos.ids[row], text)
            self._stop = None
        if now > self._hold_due:
            text = f"{self._silence * 1e3:.0f} ms without a packet while armed, and no hold after it"
            self._broken("W7", now, None, text)
            self._hold_due = np.inf
