"""A bus with both halves and scripted servos behind it, for the tests of the writing half."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tests.support.dynamixel_responder import Servos, Wire
from twind_drivers.bus import Script
from twind_drivers.clock import FakeClock
from twind_drivers.dynamixel.dynamixel_reader import DynamixelReader
from twind_drivers.dynamixel.dynamixel_writer import DynamixelWriter
from twind_drivers.dynamixel.packet import Framer, Instruction, Packet
from twind_drivers.run_script import perform

IDS = (1, 2, 3)
SYNC = Instruction.SYNC_WRITE
FAST = Instruction.FAST_SYNC_READ
LIMITS = {36: 885, 38: 1193, 44: 1023}  # PWM, current, velocity limit: address -> value
XM430 = 1020


class Bench:
    """Reader, writer, servos. `more` goes to the writer; bounds are 1000..3000 unless given."""

    def __init__(
        self,
        ids: Sequence[int] = IDS,
        models: Sequence[int] | None = None,
        fast: bool = True,
        kind: type[Servos] = Servos,
        **more: Any,
    ) -> None:
        self.ids = tuple(ids)
        self.servos = kind(self.ids)
        numbers = [XM430] * len(self.ids) if models is None else list(models)
        modes = more.get("modes") or [3] * len(self.ids)
        for id, number, mode in zip(self.ids, numbers, modes, strict=True):
            self.servos.put(id, 0, number, 2)
            self.servos.put(id, 11, mode, 1)
            self.servos.put(id, 100, LIMITS[36], 2)
            for address, value in LIMITS.items():
                self.servos.put(id, address, value, 4 if address == 44 else 2)
        self.wire = Wire(self.servos)
        self.clock = FakeClock()
        self.reader = DynamixelReader(
            "main", self.wire, self.ids, numbers, baud=1_000_000, return_delay_us=0, fast=fast
        )
        bounds = {"lower": np.full(len(self.ids), 1000), "upper": np.full(len(self.ids), 3000)}
        self.writer = DynamixelWriter(self.reader, **{**bounds, **more})

    def run(self, script: Script[Any]) -> Any:
        """A script to its end."""
        return perform(self.reader, script, self.clock, self.writer)

    def sent(self, place: int = -1) -> list[Packet]:
        """The packets of one system call."""
        return Framer(status=False).feed(self.wire.writes[place])

    def cycle(self) -> None:
        """One cyclic reading, with the goals that are pending."""
        self.reader.request(self.clock.now())
        assert self.reader.feed(self.clock.now())
        self.reader.finish(self.clock.now())

    def addresses(self, place: int = -1) -> list[tuple[int, int]]:
        """(instruction, address) of the packets of one system call."""
        return [(each.instruction, int.from_bytes(each.params[:2], "little")) for each in self.sent(place)]
