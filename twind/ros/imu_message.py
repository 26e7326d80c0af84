"""Messages of one IMU, `sensor_msgs/msg/Imu`, written at the loop's rate and read as numbers."""

from collections.abc import Sequence
from struct import Struct

from twind.ros.cdr import HEAD, encode
from twind.ros.joint_state_message import stamp
from twind.ros.message_definitions import IMU

NUMBERS = Struct("<37d")  # orientation x y z w, rates, forces; behind each 9 of its covariance
_STAMP = Struct("<iI")
_NONE = [0.0] * 9  # a covariance that is not known


def imu_numbers(data: bytes) -> tuple[float, ...]:
    """Return gyro, acceleration, quaternion w x y z: 10 numbers. Raises struct.error: too short."""
    x, y, z, w, *rest = NUMBERS.unpack_from(data, max(0, len(data) - NUMBERS.size))
    return (*rest[9:12], *rest[21:24], w, x, y, z)


class ImuBuffer:
    """Fills one message again and again, in the axes of the base."""

    def __init__(self) -> None:
        vector = dict.fromkeys("xyz", 0.0)
        self._data = bytearray(
            encode(
                IMU,
                {
                    "header": {"stamp": stamp(0), "frame_id": "base"},
                    "orientation": vector | {"w": 0.0},
                    "orientation_covariance": _NONE,
                    "angular_velocity": vector,
                    "angular_velocity_covariance": _NONE,
                    "linear_acceleration": vector,
                    "linear_acceleration_covariance": _NONE,
                },
            )
        )

    def fill(
        self, time_ns: int, gyro: Sequence[float], force: Sequence[float], quaternion: Sequence[float]
    ) -> bytes:
        """The message of `time_ns` (since 1970): rad/s, m/s², w x y z."""
        when = stamp(time_ns)
        w, x, y, z = quaternion
        _STAMP.pack_into(self._data, len(HEAD), when["sec"], when["nanosec"])
        numbers = (x, y, z, w, *_NONE, *gyro, *_NONE, *force, *_NONE)
        NUMBERS.pack_into(self._data, len(self._data) - NUMBERS.size, *numbers)
        return bytes(self._data)
