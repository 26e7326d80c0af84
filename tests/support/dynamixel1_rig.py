"""A bus of Protocol 1.0 on virtual servos, in process under a fake clock."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tests.support.driver_rig import DriverRig
from tests.support.feetech_rig import Counted
from twind_drivers.clock import FakeClock
from twind_drivers.dynamixel1.dynamixel1_models import model
from twind_drivers.dynamixel1.dynamixel1_reader import Dynamixel1Reader
from twind_drivers.dynamixel1.dynamixel1_writer import Dynamixel1Writer
from twind_drivers.dynamixel1.virtual_dynamixel1_bus import VirtualDynamixel1Bus
from twind_drivers.dynamixel1.virtual_dynamixel1_spec import Dynamixel1ServoSpec
from twind_drivers.virtual.servo_physics import FirstOrderPhysics

QUICK = {"return_delay_time": 0}


class Dynamixel1Rig(DriverRig):
    """Servos in the middle of their travel, limp, at 1 Mbaud; by default four MX-28."""

    def __init__(self, specs: Sequence[Dynamixel1ServoSpec] | None = None, **bus: Any) -> None:
        self.name = "dynamixel1"
        own = specs or [Dynamixel1ServoSpec(id, "MX-28(1.0)", QUICK) for id in (1, 2, 3, 4)]
        counts = np.array([model(each.model).counts for each in own])
        if counts[0] == 1024:
            self.stroke = 100.0  # their counts are 3.3 times as wide
        self.muscles = FirstOrderPhysics(counts / 2.0)
        self.bus = VirtualDynamixel1Bus("test", own, self.muscles, **bus)
        self.servos = self.bus.servos
        self.clock = FakeClock()
        self.faults = self.bus.faults
        self.port = Counted(self.bus, self.clock)
        self.lower = np.zeros(len(own), np.int64)
        self.upper = counts - 1
        ids = [each.id for each in own]
        delay = max(2 * each.settings.get("return_delay_time", 250) for each in own)
        self.reader: Dynamixel1Reader = Dynamixel1Reader(
            "arm", self.port, ids, [each.model for each in own], baud=1_000_000, return_delay_us=delay
        )
        self.writer: Dynamixel1Writer = Dynamixel1Writer(self.reader, lower=self.lower, upper=self.upper)

    def places(self) -> np.ndarray:
        return np.rint(self.muscles.position).astype(np.int64)

    def energised(self) -> np.ndarray:
        return np.array([self.servos.get(row, "torque_enable") == 1 for row in range(self.m)])

    def sent(self) -> int:
        return self.port.written
