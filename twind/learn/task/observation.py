"""Conversion of a reading to an observation: numpy alone, for one robot or many (leading dimensions)."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from twind.learn.task.observation_layout import BASE, ObservationLayout
from twind.robot.arrays import Floats

Observations = NDArray[np.float32]


class BodyReading:
    """Measured state of the robot at one moment: named views of one buffer (…, 2n + 25).

    A body fills it; noise or a delay may be applied to the whole buffer at once.
    """

    __slots__ = (
        "acceleration",
        "base",
        "base_velocity",
        "gravity",
        "gyro",
        "height",
        "joints",
        "position",
        "sole_velocities",
        "soles",
        "values",
        "velocity",
    )

    def __init__(self, values: Floats) -> None:
        """`values` (…, 2n + 25) is kept, not copied."""
        n, odd = divmod(values.shape[-1] - BASE, 2)
        if n < 1 or odd:
            raise ValueError(f"a reading of {values.shape[-1]} numbers: 2n + {BASE} of n joints are needed")
        base = values[..., 2 * n :]
        feet = (*values.shape[:-1], 2, 3)
        self.values = values
        self.joints: Floats = values[..., : 2 * n]  # positions and velocities
        self.position: Floats = values[..., :n]  # rad
        self.velocity: Floats = values[..., n : 2 * n]  # rad/s
        self.base: Floats = base  # all below, as the layout has it
        self.gyro: Floats = base[..., 0:3]  # rad/s, base frame
        self.acceleration: Floats = base[..., 3:6]  # m/s², what an accelerometer feels, base frame
        self.gravity: Floats = base[..., 6:9]  # unit vector downwards, base frame
        self.height: Floats = base[..., 9]  # m, of the base above the lower sole; () a writable 0-d view
        self.base_velocity: Floats = base[..., 10:13]  # m/s, base frame
        # Splitting the last axis of a view needs no copy, whatever its strides.
        self.soles: Floats = base[..., 13:19].reshape(feet)  # m, left and right from the base, base frame
        self.sole_velocities: Floats = base[..., 19:25].reshape(feet)  # m/s

    @classmethod
    def empty(cls, joints: int, shape: tuple[int, ...] = ()) -> "BodyReading":
        """Return a buffer for readings of `shape` robots, all zero: to be filled before it is used."""
        return cls(np.zeros((*shape, 2 * joints + BASE)))


def columns(base: Floats) -> "list[Any] | Floats":
    """The numbers of `BodyReading.base` one by one, each a float of one robot or an array (count,) of many.

    What is made of them by arithmetic alone is then the same for both, and of one robot ten times as fast.
    """
    return base.tolist() if base.ndim == 1 else base.T


def height_of(base: Floats) -> Any:
    """Compute the height of the base above the lower sole, m, (…,).

    It follows from the direction of gravity and the positions of the soles.
    """
    c = columns(base)
    left = c[13] * c[6] + c[14] * c[7] + c[15] * c[8]
    right = c[16] * c[6] + c[17] * c[7] + c[18] * c[8]
    return 0.5 * (left + right + abs(left - right))


class ObservationBuilder:
    """Makes observations of the readings of one robot, or of `shape` robots."""

    def __init__(self, layout: ObservationLayout, default: Floats, shape: tuple[int, ...] = ()) -> None:
        """`default` (n,): the task's pose, rad, that positions count from."""
        n = len(layout.joints)
        if default.shape != (n,):
            raise ValueError(f"a default pose of shape {default.shape} for {n} joints")
        self.layout = layout
        self._origin = np.concatenate([default, np.zeros(n)])
        self._low = -layout.most
        self._high = layout.most
        self._scratch = scratch = np.zeros((*shape, layout.size))
        at = layout.places
        self._joints = scratch[..., : 2 * n]
        self._action, self._lag, self._base, self._command, self._phase = (
            scratch[..., at[name]] for name in ("action", "lag", "base", "command", "phase")
        )

    def observe(
        self, reading: BodyReading, action: NDArray[Any], target: Floats, command: Floats, phase: Floats
    ) -> Observations:
        """A new array (…, 4n + 32). `action` (…, n), `target` (…, n) rad, `command` (…, 3), `phase` (…, 4).

        Entries beyond the layout's bounds are cut to them, as a sensor would; NaN stays NaN.
        """
        np.subtract(reading.joints, self._origin, self._joints)
        np.subtract(target, reading.position, self._lag)
        self._action[...] = action
        self._base[...] = reading.base
        self._command[...] = command
        self._phase[...] = phase
        np.maximum(self._scratch, self._low, out=self._scratch)  # in two: cheaper than `clip`
        np.minimum(self._scratch, self._high, out=self._scratch)
        return self._scratch.astype(np.float32)
