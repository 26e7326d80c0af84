"""Attitude of a body from its gyroscope and accelerometer. Pure; time is an argument.

A complementary filter (Mahony's): the gyro is integrated. The accelerometer pulls the tilt towards its
direction of gravity with a time constant of a second, and corrects the gyro's bias. It counts only near one
g: in shaking or falling it has no direction of gravity. Yaw is the integral of the gyro alone, 0 at the
beginning: it drifts.
"""

from math import cos, hypot, inf, isfinite, sin, sqrt

import numpy as np

from twind.robot.arrays import Floats

G = 9.80665  # m/s²
PULL = 1.0  # 1/s, of the tilt
LEARN = 0.1  # 1/s², of the bias
BIAS = 0.1  # rad/s, the largest bias that is corrected: a MEMS gyro in the sun
TRUST = 0.2  # of g: largest deviation of an acceleration that still gives the direction of gravity
GAP = 0.2  # s: after a longer gap the tilt is taken anew from the accelerometer, once it is near one g

Quaternion = tuple[float, float, float, float]
UPRIGHT: Quaternion = (1.0, 0.0, 0.0, 0.0)


class Attitude:
    """Attitude of one body. `quaternion`: w x y z, from its axes (x forward, y left, z up) to the world's."""

    def __init__(self) -> None:
        self.quaternion = UPRIGHT
        self.bias = (0.0, 0.0, 0.0)  # rad/s, subtracted from the gyro
        self._time = -inf  # s, of the last reading
        self._known = False  # gravity's direction was measured, and the gyro read ever since

    def update(self, gyro: Floats, acceleration: Floats, time: float) -> Quaternion | None:
        """Process a reading (rad/s, m/s²) at `time` (s).

        One not finite, or of no later time, changes nothing.

        Returns None while unknown, at the beginning and after a gap, until the acceleration is near one g: a
        body in the air does not count as standing.
        """
        reading = (*gyro.tolist(), *acceleration.tolist())
        if not all(map(isfinite, reading)) or time <= self._time:
            return self.quaternion if self._known else None
        step = time - self._time
        self._time = time
        x, y, z, *force = reading
        size = hypot(*force)
        sure = max(0.0, 1.0 - abs(size / G - 1.0) / TRUST)
        if not self._known or step > GAP:
            self._known = sure > 0.0
            if not self._known:
                return None
            self.quaternion = tilted(self.quaternion, _direction(force, size))
            return self.quaternion
        if sure > 0.0:
            error = _cross(_direction(force, size), up(self.quaternion))
            self.bias = _learnt(self.bias, error, sure * LEARN * step)
            x = x + PULL * sure * error[0]
            y = y + PULL * sure * error[1]
            z = z + PULL * sure * error[2]
        bias = self.bias
        self.quaternion = turned(self.quaternion, (x - bias[0], y - bias[1], z - bias[2]), step)
        return self.quaternion


def up(quaternion: Quaternion) -> tuple[float, float, float]:
    """Return the world's up in the body's axes."""
    w, x, y, z = quaternion
    return (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y))


def turned(quaternion: Quaternion, rate: tuple[float, float, float], seconds: float) -> Quaternion:
    """Return the attitude after turning at `rate` (rad/s, in the body's own axes) for `seconds`.

    Of unit length.
    """
    w, x, y, z = quaternion
    half = hypot(*rate) * seconds / 2.0
    share = sin(half) / half * seconds / 2.0 if half > 0.0 else 0.0
    c = cos(half)
    i, j, k = (each * share for each in rate)
    return unit(
        (
            w * c - x * i - y * j - z * k,
            w * i + x * c + y * k - z * j,
            w * j - x * k + y * c + z * i,
            w * k + x * j - y * i + z * c,
        )
    )


def product(one: Quaternion, other: Quaternion) -> Quaternion:
    """Return the rotation by `other`, then by `one`."""
    w, x, y, z = one
    a, b, c, d = other
    return (
        w * a - x * b - y * c - z * d,
        w * b + x * a + y * d - z * c,
        w * c - x * d + y * a + z * b,
        w * d + x * c - y * b + z * a,
    )


def conjugate(quaternion: Quaternion) -> Quaternion:
    """Return the inverse rotation."""
    w, x, y, z = quaternion
    return (w, -x, -y, -z)


def unit(quaternion: Quaternion) -> Quaternion:
    """Scale a quaternion to length 1.

    Return UPRIGHT for one of length zero or with a value that is not finite.
    """
    w, x, y, z = quaternion
    size = sqrt(w * w + x * x + y * y + z * z)
    return (w / size, x / size, y / size, z / size) if 0.0 < size < float("inf") else UPRIGHT


def matrix(quaternion: Quaternion) -> Floats:
    """Return the rotation matrix (3, 3) of a quaternion of length 1."""
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def tilted(quaternion: Quaternion, force: tuple[float, float, float]) -> Quaternion:
    """Return the same heading with up along `force` (of unit length): the shortest turn there."""
    above = up(quaternion)
    x, y, z = _cross(force, above)
    cosine = sum(one * other for one, other in zip(force, above, strict=True))
    if cosine < -1.0 + 1e-9:  # head down: half a turn about a horizontal axis of the world
        return unit(product((0.0, 1.0, 0.0, 0.0), quaternion))
    return unit(product(quaternion, (1.0 + cosine, x, y, z)))


def _direction(force: list[float], size: float) -> tuple[float, float, float]:
    """Return the direction (of unit length) of a force of this size."""
    x, y, z = force
    return (x / size, y / size, z / size)


def _learnt(
    bias: tuple[float, float, float], error: tuple[float, float, float], share: float
) -> tuple[float, float, float]:
    x, y, z = (min(BIAS, max(-BIAS, b - share * e)) for b, e in zip(bias, error, strict=True))
    return (x, y, z)


def _cross(one: tuple[float, float, float], other: tuple[float, float, float]) -> tuple[float, float, float]:
    a, b, c = one
    x, y, z = other
    return (b * z - c * y, c * x - a * z, a * y - b * x)
