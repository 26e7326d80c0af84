"""Capture point of a robot on its own feet: where it would have to step to come to rest. Pure.

The centre of mass plus its velocity divided by the rate of an inverted pendulum (Pratt et al., "Capture
Point", Humanoids 2006). It stays between the feet in a stance and in a walk. Places come from the model,
joints and IMU; contact is not measured: a lifted robot counts as standing on its lowest corner.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite, sqrt

import numpy as np

from twind.robot.arrays import Floats
from twind.robot.attitude import G
from twind.robot.joint_state import Imu

SMOOTH = 0.02  # s, time constant of the velocity: encoders move a mass 0.4 m away in steps of 0.6 mm
LEAST_HEIGHT = 0.05  # m of the mass above the floor; lower, a pendulum tells nothing


@dataclass(frozen=True, slots=True)
class SupportPoints:
    """Places relative to the base, m, in axes with z up."""

    mass: Floats  # (3,), centre of mass
    corners: Floats  # (p, 3), of the soles of all feet, in the same order each time


# joint angles (n,), rad, and orientation w x y z (4,) of the base -> places
Geometry = Callable[[Floats, Floats], SupportPoints]
# corners (p, 2) and a place (2,), m -> how far the place is inside their hull, m; negative: outside
Inside = Callable[[Floats, Floats], float]


class CapturePoint:
    """Distance of the capture point inside the feet, from successive readings."""

    def __init__(self, geometry: Geometry, inside: Inside) -> None:
        self._geometry = geometry
        self._inside = inside
        self._before: tuple[float, Floats] | None = None  # s; places of the mass relative to the corners
        self._velocity = np.zeros(2)  # m/s, from the second reading on

    def forget(self) -> None:
        """Begin anew: the next velocity is not known."""
        self._before = None

    def margin(self, position: Floats, imu: Imu) -> float:
        """Return the margin, m; negative: outside, NaN: unknown. Joint angles (n,), rad."""
        points = self._geometry(position, imu.quaternion)
        from_corners = points.mass - points.corners
        lowest = int(points.corners[:, 2].argmin())
        if self._before is None:
            self._velocity = np.zeros(2)
        else:
            time, before = self._before
            step = imu.time - time
            moved = (from_corners[lowest] - before[lowest])[:2] / step
            self._velocity = self._velocity + (moved - self._velocity) * step / (step + SMOOTH)
        self._before = imu.time, from_corners
        height = max(float(from_corners[lowest, 2]), LEAST_HEIGHT)
        capture = points.mass[:2] + self._velocity * sqrt(height / G)
        margin = self._inside(points.corners[:, :2], capture)
        if not isfinite(margin):
            self._before = None
        return margin
