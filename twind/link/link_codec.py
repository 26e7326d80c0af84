"""Encoding of messages: msgpack datagrams, and the arrays of a trajectory as float64, one after the other."""

import msgspec
import numpy as np

from twind.link.link_commands import Inward, Submit
from twind.link.link_reports import Outward
from twind.robot.arrays import Floats
from twind.robot.trajectory import Trajectory

DATAGRAM = 1 << 17  # bytes: largest datagram of the link

# text that is none, endless nesting: msgspec has no error of its own for them
_NO_MESSAGE = (UnicodeDecodeError, RecursionError)

_encoder = msgspec.msgpack.Encoder()
_inward = msgspec.msgpack.Decoder(Inward)
_outward = msgspec.msgpack.Decoder(Outward)


def encode(message: Inward | Outward) -> bytes:
    """Encode a message as one datagram."""
    return _encoder.encode(message)


def decode_command(data: bytes) -> Inward:
    """Decode a datagram from the front. Raises msgspec.DecodeError."""
    try:
        command: Inward = _inward.decode(data)
    except _NO_MESSAGE as error:
        raise msgspec.DecodeError(str(error)) from None
    return command


def decode_news(data: bytes) -> Outward:
    """Decode a datagram from the loop. Raises msgspec.DecodeError."""
    try:
        news: Outward = _outward.decode(data)
    except _NO_MESSAGE as error:
        raise msgspec.DecodeError(str(error)) from None
    return news


def pack_path(path: Trajectory) -> bytes:
    """Encode time (k,), position (k, n), velocity and acceleration: float64, concatenated."""
    parts = [path.time, path.position, path.velocity, path.acceleration]
    return b"".join(np.ascontiguousarray(part, np.float64).tobytes() for part in parts if part is not None)


def unpack_path(data: bytes, submit: Submit, count: int) -> Trajectory:
    """Decode the trajectory of `submit` for `count` joints.

    Raises ValueError when the two do not fit exactly.
    """
    k = submit.points
    joints = list(submit.commanded)
    if submit.acceleration and not submit.velocity:
        raise ValueError("accelerations need velocities")
    if not all(0 <= joint < count for joint in joints):
        raise ValueError(f"joints {joints}: this robot has 0..{count - 1}")
    blocks = 1 + int(submit.velocity) + int(submit.acceleration)
    numbers: Floats = np.frombuffer(data, np.float64)
    if k < 1 or numbers.size != k * (1 + blocks * count):
        raise ValueError(f"trajectory of {k} points x {count} joints: got {numbers.size} numbers")
    columns = [block.reshape(k, count) for block in np.split(numbers[k:], blocks)]
    commanded = np.zeros(count, np.bool_)
    commanded[joints] = True
    return Trajectory(numbers[:k], columns[0], commanded, *columns[1:])
