"""Frames of every kind, as ours and as python-can's, for the tests of channels."""

import can
import numpy as np

from twind_drivers.clock import MonotonicClock
from twind_drivers.ports.channel import CanChannel
from twind_drivers.ports.frame import EXTENDED, FRAME, REMOTE, Frames, frames, payload


def cycle(count: int) -> Frames:
    data = np.random.default_rng(count).integers(0, 256, (count, 8), dtype=np.uint8)
    return frames(np.arange(1, count + 1), data)


def mixed() -> Frames:
    """One frame of each kind, and every size."""
    rows = np.zeros(12, FRAME)
    for size in range(9):
        rows[size]["id"] = 0x100 + size
        rows[size]["size"] = size
        rows[size]["data"][:size] = range(0xF0, 0xF0 + size)
    rows[9]["id"] = 0x1ABCDEF0 | EXTENDED
    rows[9]["size"] = 8
    rows[10]["id"] = 0x123 | REMOTE
    rows[10]["size"] = 4
    rows[11]["id"] = 0x7F | EXTENDED | REMOTE
    return rows


def messages_of(rows: Frames) -> list[can.Message]:
    return [
        can.Message(
            arbitration_id=int(row["id"]) & 0x1FFFFFFF,
            is_extended_id=bool(int(row["id"]) & EXTENDED),
            is_remote_frame=bool(int(row["id"]) & REMOTE),
            dlc=int(row["size"]),
            data=None if int(row["id"]) & REMOTE else payload(row),
        )
        for row in rows
    ]


def same(message: can.Message, wanted: can.Message) -> bool:
    return message.equals(wanted, timestamp_delta=None, check_channel=False, check_direction=False)


def received_frames(channel: CanChannel, count: int) -> Frames:
    """Frames that a channel receives, once there are `count`, in real time."""
    clock = MonotonicClock()
    parts = [cycle(0)]
    total = 0
    deadline = clock.now() + 5.0
    while total < count and clock.now() < deadline:
        clock.wait([channel], deadline)
        parts.append(channel.receive(clock.now()))
        total += len(parts[-1])
    return np.concatenate(parts)
