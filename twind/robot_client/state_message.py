"""One state of the robot from `Monitor`: arrays in joint order. Pure; NaN where a value is unknown."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np

from twind.robot.arrays import Floats

STALE = 0.05  # s: a joint or an IMU that was read longer ago does not count
LONG = 2.0  # s of silence, reported in seconds and with a remedy
_NAN = float("nan")
_INF = inf


@dataclass(frozen=True, slots=True)
class ImuReading:
    """Reading of the IMU, base frame."""

    gyro: Floats  # rad/s, (3,)
    acceleration: Floats  # m/s², (3,)
    quaternion: Floats  # w x y z, (4,)
    age: float  # s, when the state was sent


@dataclass(frozen=True, slots=True)
class StateMessage:
    """One message of the topic `state`. Rows are (n,)."""

    time: float  # s, monotonic: the tick it is of
    arrived: float  # s, monotonic, here
    sequence: int  # of the tick
    position: Floats  # rad, measured; in mode sim of the simulation
    velocity: Floats  # rad/s
    goal: Floats  # rad, what the loop commands now; NaN: nothing
    age: Floats  # s, when the state was sent
    inertial: ImuReading | None
    rows: Sequence[Mapping[str, Any]] = ()  # each joint as the daemon sent it

    def stale(self, now: float, bound: float, joints: Sequence[str]) -> str | None:
        """Return a text on what is older than `bound` s, or unknown, at time `now`; None: all is fresh."""
        past = now - self.time
        if not 0.0 <= past <= bound:
            return f"the state is {past * 1e3:.0f} ms old, bound {bound * 1e3:.0f} ms"
        fresh = (self.age + past <= bound) & np.isfinite(self.position) & np.isfinite(self.velocity)
        if not fresh.all():
            joint = int(np.argmin(fresh))
            return f"{joints[joint]} {_silence(float(self.age[joint]) + past, bound)}"
        imu = self.inertial
        if imu is None:
            return "there is no IMU, or it has not been read yet"
        rows = (imu.gyro, imu.acceleration, imu.quaternion)
        if not (imu.age + past <= bound and all(np.isfinite(row).all() for row in rows)):
            return f"the IMU {_silence(imu.age + past, bound)}"
        if not abs(float(imu.quaternion @ imu.quaternion) - 1.0) <= 0.02:
            return f"the IMU's quaternion has the size {float(np.linalg.norm(imu.quaternion)):.2f}, not 1"
        return None


def _silence(past: float, bound: float) -> str:
    """Return a text on how long no reading has come, s."""
    if not past > bound:
        return "gave no numbers"
    if past < LONG:
        return f"was read {past * 1e3:.0f} ms ago, bound {bound * 1e3:.0f} ms"
    return "has not been read yet" if past == inf else f"is silent for {past:.0f} s: its cable and power"


def decode_state_message(answer: Mapping[str, Any], arrived: float, joints: Sequence[str]) -> StateMessage:
    """Convert one answer of `Monitor` to a state. Raises ValueError where its joints are not `joints`."""
    rows = answer["joints"]
    if [row["name"] for row in rows] != list(joints):
        raise ValueError("the robot has other joints now")
    return StateMessage(
        time=answer["time"],
        arrived=arrived,
        sequence=answer["sequence"],
        position=_row(rows, "position", _NAN),
        velocity=_row(rows, "velocity", _NAN),
        goal=_row(rows, "goal", _NAN),
        age=_row(rows, "age_ms", _INF) / 1e3,
        inertial=_inertial(answer.get("imu")),
        rows=rows,
    )


def _row(rows: Sequence[Mapping[str, Any]], key: str, unknown: float) -> Floats:
    return np.array([unknown if row[key] is None else row[key] for row in rows], np.float64)


def _inertial(imu: Mapping[str, Any] | None) -> ImuReading | None:
    if imu is None:
        return None
    gyro, acceleration, quaternion = (
        np.array([_NAN if each is None else each for each in imu[key]], np.float64)
        for key in ("gyro", "acceleration", "quaternion")
    )
    if gyro.shape != (3,) or acceleration.shape != (3,) or quaternion.shape != (4,):
        return None
    age = imu["age_ms"]
    return ImuReading(gyro, acceleration, quaternion, _INF if age is None else age / 1e3)
