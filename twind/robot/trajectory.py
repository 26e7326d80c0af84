"""A path in time, and a reference on it."""

from dataclasses import dataclass, replace

from twind.robot.arrays import Bools, Floats


@dataclass(frozen=True, slots=True)
class Reference:
    """Intended motion at one instant. Arrays are (n,)."""

    position: Floats  # rad
    velocity: Floats  # rad/s
    acceleration: Floats  # rad/s²


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Points of all joints; those not `commanded` go on as they are, and their columns are ignored.

    Velocities (and then accelerations) are given for every point or for none.
    """

    time: Floats  # s from start, (k,), strictly increasing
    position: Floats  # rad, (k, n)
    commanded: Bools  # (n,)
    velocity: Floats | None = None  # rad/s, (k, n)
    acceleration: Floats | None = None  # rad/s², (k, n); needs velocity

    def stretched(self, factor: float) -> "Trajectory":
        """Return the same path, `factor` times as long: velocities and accelerations scaled to match."""
        return replace(
            self,
            time=self.time * factor,
            velocity=None if self.velocity is None else self.velocity / factor,
            acceleration=None if self.acceleration is None else self.acceleration / factor**2,
        )
