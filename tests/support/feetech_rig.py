"""A Feetech bus on virtual servos, in process under a fake clock."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tests.support.driver_rig import DriverRig
from twind_drivers.clock import FakeClock
from twind_drivers.feetech.feetech_reader import FeetechReader
from twind_drivers.feetech.feetech_writer import FeetechWriter
from twind_drivers.feetech.virtual_feetech_bus import VirtualFeetechBus
from twind_drivers.feetech.virtual_feetech_spec import FeetechServoSpec
from twind_drivers.virtual.serial_loopback import Loopback
from twind_drivers.virtual.servo_physics import FirstOrderPhysics


class Counted(Loopback):
    """Counts what is written."""

    written = 0

    def write(self, data: bytes | bytearray | memoryview) -> None:
        super().write(data)
        self.written += len(data)


class FeetechRig(DriverRig):
    """Servos in the middle of their travel, limp, at 1 Mbaud."""

    def __init__(self, specs: Sequence[FeetechServoSpec] | None = None, **bus: Any) -> None:
        self.name = "feetech"
        own = specs or [FeetechServoSpec(id) for id in (1, 2, 3, 4)]
        middle = np.array([512.0 if each.model.startswith("SCS") else 2048.0 for each in own])
        if middle[0] < 2048.0:
            self.stroke = 100.0  # their counts are 3.3 times as wide
        self.muscles = FirstOrderPhysics(middle)
        self.bus = VirtualFeetechBus("test", own, self.muscles, **bus)
        self.servos = self.bus.servos
        self.clock = FakeClock()
        self.faults = self.bus.faults
        self.port = Counted(self.bus, self.clock)
        self.lower = np.zeros(len(own), np.int64)
        self.upper = (2 * middle - 1).astype(np.int64)
        ids = [each.id for each in own]
        self.reader: FeetechReader = FeetechReader(
            "arm", self.port, ids, [each.model for each in own], baud=1_000_000
        )
        self.writer: FeetechWriter = FeetechWriter(self.reader, lower=self.lower, upper=self.upper)

    def places(self) -> np.ndarray:
        return np.rint(self.muscles.position).astype(np.int64)

    def energised(self) -> np.ndarray:
        return np.array([self.servos.get(row, "torque_enable") == 1 for row in range(self.m)])

    def sent(self) -> int:
        return self.port.written
