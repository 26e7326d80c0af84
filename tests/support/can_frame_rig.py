"""A reader and a writer of CAN actuators on a channel on which a test plays all devices, frame by frame."""

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

from tests.support.can_driver_rig import BITRATE, EDGE, actuators
from twind_drivers.bus import BusSample, ReadRequest
from twind_drivers.can.can_reader import CanReader
from twind_drivers.can.can_writer import CanWriter
from twind_drivers.can.register_access import STATE
from twind_drivers.ports.channel import CanChannelStatus
from twind_drivers.ports.frame import NOTHING, Frames, frames

DM, AK, OD = "DM4310", "AK70-10", "ODrive"
BOTH = ReadRequest((1, 2), STATE, 3)
PERIOD = 0.0078125  # s, of a binary fraction: sums of it are exact


class Wire:
    """Channel on which a test plays all devices."""

    def __init__(self) -> None:
        self.name = self.warning = ""
        self.condition = CanChannelStatus()
        self.sent: list[Frames] = []
        self.coming: list[Frames] = []

    def fileno(self) -> int:
        return -1

    def arrival(self) -> float:
        return 0.0

    def send(self, frames: Frames, now: float) -> None:
        self.sent.append(frames)

    def receive(self, now: float) -> Frames:
        come, self.coming = self.coming, []
        return np.concatenate(come) if come else NOTHING

    def drive(self, owner: object) -> None:
        pass

    def purge(self) -> None:
        pass

    def close(self) -> None:
        pass


def dm(id: int, place: int = 0x8000, *, state: int = 1) -> Frames:
    """Feedback of a Damiao; `state`: 0 off, 1 on, 8 and more a fault."""
    data = bytes([state << 4 | id, *place.to_bytes(2, "big"), 0x7F, 0xF7, 0xFF, 25, 25])
    return frames([id + 0x10], np.frombuffer(data, np.uint8)[None])


def ak(id: int, place: int = 0x8000) -> Frames:
    """Feedback of a CubeMars."""
    data = bytes([id, *place.to_bytes(2, "big"), 0x7F, 0xF7, 0xFF, 65, 0])
    return frames([0], np.frombuffer(data, np.uint8)[None])


def estimates(id: int, turns: float = 0.125, speed: float = 0.0) -> Frames:
    """Position and velocity of an ODrive."""
    return frames([id << 5 | 0x09], np.frombuffer(struct.pack("<ff", turns, speed), np.uint8)[None])


def heartbeat(id: int) -> Frames:
    return frames([id << 5 | 0x01], np.frombuffer(struct.pack("<IB3x", 0, 8), np.uint8)[None])


class Reading:
    """A reader and a writer on such a channel."""

    def __init__(self, *models: str) -> None:
        self.wire = Wire()
        self.reader = CanReader("arm", self.wire, actuators(models), bitrate=BITRATE)
        m = self.m = len(models)
        edge = np.full(m, EDGE)
        self.writer = CanWriter(self.reader, lower=-edge, upper=edge, kp=np.full(m, 40.0), kd=np.ones(m))
        self.cyclic = self.reader.cyclic

    def request(self, at: float, *, goal: bool = False) -> Frames:
        """The frames of a reading that begins; `goal`: beside commands to all that are not barred."""
        if goal:
            self.writer.goals(np.zeros(self.m, np.int64))
        count = len(self.wire.sent)
        self.reader.request(at)
        sent = self.wire.sent[count:]
        return sent[0] if sent else NOTHING

    def cycle(self, at: float, *answers: Frames, goal: bool = False) -> BusSample:
        """A whole reading, which ends when it begins."""
        self.request(at, goal=goal)
        self.wire.coming += answers
        self.reader.feed(at)
        return self.reader.finish(at)

    def rare(self, request: Any, at: float, *answers: Frames) -> Any:
        self.reader.begin(request, at)
        self.wire.coming += answers
        self.reader.feed(at)
        return self.reader.answer(at)

    def believed(self, begin: float, *cycles: Sequence[Frames], goal: bool = False) -> list[list[bool]]:
        """Masks of the actuators that were believed in readings one period apart."""
        return [
            self.cycle(begin + step * PERIOD, *answers, goal=goal).heard.tolist()
            for step, answers in enumerate(cycles)
        ]

    def hold(self, *rows: int, at: float = 0.0) -> None:
        """The torque of these is on from now on, their watchdogs are armed where they have one."""
        chosen = np.zeros(self.m, np.bool_)
        chosen[list(rows)] = True
        self.cyclic.watched = self.reader.fleet.answers > 0
        self.cyclic.energise(chosen, at)
