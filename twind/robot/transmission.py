"""Conversion from actuators to joints where several turn them together: differentials and linkages. Pure.

Angles are rad: of k actuators after zero, sign and ratio, and of the k joints they drive, each in the order
of the robot file. An unknown place is NaN, and so are actuators that cannot bring the joints to a place. The
arithmetic:

    position  q = F(a)        a = F⁻¹(q)
    velocity  dq = J da       J = dF/da at the place
    effort    τ_a = Jᵀ τ_q    τ_q = J⁻ᵀ τ_a    (no power is lost: τ_a · da = τ_q · dq)

This module has the interface of every transmission and the differential; `linkage_table.py` has the table.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from twind.robot.arrays import Floats, Ints, corners

MOST_CONDITION = 100.0  # beyond it one per cent of an actuator's angle or torque may be all of a joint's


class Transmission(Protocol):
    """Relation of k actuators and the k joints that they drive. Two are equal when they do the same."""

    def forward(self, actuators: Floats) -> Floats:
        """Return joint angles (k,) at actuator angles (k,); NaN where they are unknown."""

    def inverse(self, joints: Floats) -> Floats:
        """Return actuator angles (k,) at joint angles (k,); NaN where no actuator angles give them."""

    def jacobian(self, actuators: Floats) -> Floats:
        """Return dq/da (k, k) at actuator angles (k,): joints in rows."""

    @property
    def places(self) -> Floats:
        """Actuator angles (m, k) at which `jacobian` takes its extreme values."""

    @property
    def slopes(self) -> Floats:
        """Jacobians at `places` (m, k, k)."""

    def extremes(self, lower: Floats, upper: Floats) -> Floats:
        """Return actuator angles (m, k) with their extremes for joints in lower..upper (k,).

        They are NaN where a place in there is unknown.
        """


class Differential:
    """Differential: joint = C · actuator, with C invertible."""

    def __init__(self, rows: Sequence[Sequence[float]]) -> None:
        """`rows` of C, one per joint. Raises ValueError: not square, not finite, not invertible."""
        self.rows = tuple(tuple(float(number) for number in row) for row in rows)
        if not self.rows or any(len(row) != len(self.rows) for row in self.rows):
            raise ValueError(f"{len(self.rows)} rows of {[len(row) for row in self.rows]} are not square")
        self._matrix = np.array(self.rows, np.float64)
        try:
            self._back = np.linalg.inv(self._matrix)
        except np.linalg.LinAlgError:
            raise ValueError("the matrix has no inverse") from None
        if not (np.isfinite(self._matrix).all() and np.isfinite(self._back).all()):
            raise ValueError("the matrix is not finite")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Differential) and self.rows == other.rows

    def __hash__(self) -> int:
        return hash(self.rows)

    def __str__(self) -> str:
        return f"joint = {[list(row) for row in self.rows]} . actuator"

    def forward(self, actuators: Floats) -> Floats:
        """See `Transmission`."""
        found: Floats = self._matrix @ actuators
        return found

    def inverse(self, joints: Floats) -> Floats:
        """See `Transmission`."""
        found: Floats = self._back @ joints
        return found

    def jacobian(self, actuators: Floats) -> Floats:
        """See `Transmission`."""
        return self._matrix

    def extremes(self, lower: Floats, upper: Floats) -> Floats:
        """See `Transmission`: the corners, since all is linear."""
        return corners(lower, upper) @ self._back.T

    @property
    def places(self) -> Floats:
        """One arbitrary place, zeros (1, k): the matrix is the same everywhere."""
        return np.zeros((1, len(self.rows)))

    @property
    def slopes(self) -> Floats:
        """The matrix alone."""
        return self._matrix[None]


@dataclass(frozen=True)
class MappedTransmission:
    """A transmission among the joints of a bus, or of all. Arrays are (k,), in its own order."""

    rows: Ints  # places of its actuators in these arrays, each that of one of its joints
    law: Transmission
    lower: Floats  # rad: within lower..upper of its joints every place is within the counts of its actuators
    upper: Floats

    def position(self, angles: Floats) -> None:
        """Convert actuator angles of a bus (m,), rad, to joint angles, in place."""
        angles[self.rows] = self.law.forward(angles[self.rows])

    def angles(self, position: Floats) -> None:
        """Convert joint angles of a bus (m,), rad, to actuator angles, in place: inverse of `position`."""
        position[self.rows] = self.law.inverse(position[self.rows])

    def speeds(self, angles: Floats, velocity: Floats) -> None:
        """Convert joint speeds of a bus (m,) to actuator speeds, in place.

        `angles` (m,): actuator angles, rad.
        """
        jacobian = self.law.jacobian(angles[self.rows])
        velocity[self.rows] = np.linalg.solve(jacobian, velocity[self.rows])

    def velocity(self, angles: Floats, speeds: Floats) -> None:
        """Convert actuator speeds of a bus (m,) to joint speeds, in place.

        `angles` (m,): actuator angles, rad.
        """
        speeds[self.rows] = self.law.jacobian(angles[self.rows]) @ speeds[self.rows]

    def effort(self, angles: Floats, efforts: Floats) -> None:
        """Convert actuator efforts of a bus (m,) to joint efforts, in place.

        `angles` (m,): actuator angles, rad.
        """
        efforts[self.rows] = np.linalg.solve(self.law.jacobian(angles[self.rows]).T, efforts[self.rows])


# ------------------------------------------------------------------------------------------- what follows


def condition(law: Transmission) -> float:
    """Return the worst condition number of its Jacobian; inf where it cannot be inverted."""
    numbers = np.linalg.cond(law.slopes)
    return float(numbers.max()) if np.isfinite(numbers).all() else float("inf")


def forth(law: Transmission) -> Floats:
    """Return (k, k): the largest movement of each joint (row) per rad of each actuator."""
    found: Floats = np.abs(law.slopes).max(axis=0)
    return found


def back(law: Transmission) -> Floats:
    """Return (k, k): the largest movement of each actuator (row) per rad of each joint."""
    found: Floats = np.abs(np.linalg.inv(law.slopes)).max(axis=0)
    return found


def fair(share: Floats, bound: Floats, own: Floats) -> Floats:
    """Return the most that each joint (k,) may do, so that all at once need no actuator above `bound` (k,).

    share @ result <= bound and result <= `own` (k,): each joint as much as it may alone, all less in one
    proportion. NaN bounds give NaN.
    """
    with np.errstate(divide="ignore", over="ignore"):
        alone = np.minimum((bound[:, None] / share).min(axis=0), own)
        return np.asarray(alone * np.minimum(1.0, (bound / (share @ alone)).min()))


def span(law: Transmission, lower: Floats, upper: Floats) -> tuple[Floats, Floats]:
    """Return least and largest actuator angles (k,) while the joints stay in lower..upper (k,).

    NaN: unknown.
    """
    angles = law.extremes(lower, upper)
    return angles.min(axis=0), angles.max(axis=0)
