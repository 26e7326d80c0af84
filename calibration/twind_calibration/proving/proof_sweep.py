"""Sweep of a joint through several places, each reached from below and from above. Pure.

Friction and backlash push against the way a joint came. Beyond the last place it goes a little further, so
that it comes to every place from both sides.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twind.robot.arrays import Floats
from twind_calibration.wiggling.joint_move import tour
from twind_calibration.wiggling.state_trace import PLACE, HoldMean, MoveHolds

PLACES = 4
OVER = 0.03  # rad beyond the outermost place: more than friction and backlash take
# rad/s, and s at least on each way
SPEED = 0.3
QUICKEST = 0.4
INSIDE = 0.01  # rad that are kept from the limits
LEAST = 0.05  # rad between first and last place: nearer together they show nothing


@dataclass(frozen=True, slots=True)
class ProofSweep:
    """The way of one joint, rad."""

    home: float
    places: Floats  # (k,), ascending

    @property
    def visits(self) -> list[float]:
        """Every place where it stays, in order: home, the places upwards, downwards, home."""
        low = float(self.places[0]) - OVER
        high = float(self.places[-1]) + OVER
        upwards = self.places.tolist()
        way = [self.home, low, *upwards, high, *upwards[::-1]]
        return way if abs(way[-1] - self.home) < PLACE else [*way, self.home]  # it may be home by then

    @property
    def farthest(self) -> float:
        """Largest distance from home, rad, signed."""
        ways = np.array(self.visits) - self.home
        return float(ways[np.abs(ways).argmax()])

    def path(self, joint: str) -> dict[str, object]:
        """As a trajectory."""
        visits = self.visits
        ways = np.abs(np.diff(visits)) / SPEED
        return tour(joint, list(zip(visits[1:], np.maximum(ways, QUICKEST).tolist(), strict=True)))


def sweeps(home: float, lower: float, upper: float, size: float) -> list[ProofSweep]:
    """Around home by `size` (rad) either way; else all above it, else all below. None fits: empty.

    They keep inside the limits, and so may be shorter.
    """
    low = lower + OVER + INSIDE
    high = upper - OVER - INSIDE
    found = []
    for first, last in ((home - size, home + size), (home, home + 2.0 * size), (home - 2.0 * size, home)):
        first = max(first, low)
        last = min(last, high)
        if last - first >= LEAST:
            found.append(ProofSweep(home, np.linspace(first, last, PLACES)))
    return found


@dataclass(frozen=True, slots=True)
class MeasuredLoads:
    """Measured loads. `poses` (k, n) rad and `effort` (k, n) N·m are means of both directions."""

    poses: Floats
    effort: Floats
    up: Floats  # (k, n) N·m
    down: Floats
    ends: MoveHolds  # at home, farthest away, home again: for the encoder


def mean_loads(sweep: ProofSweep, stays: Sequence[HoldMean]) -> MeasuredLoads:
    """Compute the measured loads from the stays at `sweep.visits`."""
    count = len(sweep.places)
    up = stays[2 : 2 + count]
    down = stays[3 + count : 3 + 2 * count][::-1]
    rose = np.array([stay.effort for stay in up])
    fell = np.array([stay.effort for stay in down])
    poses = np.array([(a.position + b.position) / 2.0 for a, b in zip(up, down, strict=True)])
    far = int(np.abs(np.array(sweep.visits) - sweep.home).argmax())
    return MeasuredLoads(poses, (rose + fell) / 2.0, rose, fell, MoveHolds(stays[0], stays[far], stays[-1]))
