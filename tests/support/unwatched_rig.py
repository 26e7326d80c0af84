"""A bus of XL-320 or PRO -R on virtual servos, in process under a fake clock."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tests.support.driver_rig import DriverRig
from tests.support.feetech_rig import Counted
from twind_drivers.clock import FakeClock
from twind_drivers.dynamixel1.virtual_dynamixel1_spec import Dynamixel1ServoSpec
from twind_drivers.dynamixel2_unwatched.unwatched_models import model
from twind_drivers.dynamixel2_unwatched.unwatched_reader import UnwatchedReader
from twind_drivers.dynamixel2_unwatched.unwatched_writer import UnwatchedWriter
from twind_drivers.dynamixel2_unwatched.virtual_unwatched_bus import VirtualUnwatchedBus
from twind_drivers.virtual.servo_physics import FirstOrderPhysics

QUICK = {"return_delay_time": 0, "baud_rate": 3}


class UnwatchedRig(DriverRig):
    """Servos in the middle of their travel, limp, at 1 Mbaud."""

    def __init__(self, models: Sequence[str], settings: dict[str, int] | None = None, **bus: Any) -> None:
        self.name = "dynamixel2_unwatched"
        own = [model(each) for each in models]
        specs = [
            Dynamixel1ServoSpec(id, each.name, QUICK | (settings or {})) for id, each in enumerate(own, 1)
        ]
        self.stroke = own[0].turn / (15.0 if own[0].table == "xl320" else 60.0)
        middles = np.array([(each.lowest + each.highest + 1) // 2 for each in own], np.float64)
        self.muscles = FirstOrderPhysics(middles)
        self.bus = VirtualUnwatchedBus("test", specs, self.muscles, **bus)
        self.servos = self.bus.servos
        self.clock = FakeClock()
        self.faults = self.bus.faults
        self.port = Counted(self.bus, self.clock)
        self.lower = np.array([each.lowest for each in own], np.int64)
        self.upper = np.array([each.highest for each in own], np.int64)
        ids = [each.id for each in specs]
        self.reader: UnwatchedReader = UnwatchedReader(
            "arm", self.port, ids, models, baud=1_000_000, return_delay_us=100
        )
        self.writer: UnwatchedWriter = UnwatchedWriter(self.reader, lower=self.lower, upper=self.upper)

    def places(self) -> np.ndarray:
        return np.rint(self.muscles.position).astype(np.int64)

    def energised(self) -> np.ndarray:
        return np.array([self.servos.get(row, "torque_enable") == 1 for row in range(self.m)])

    def sent(self) -> int:
        return self.port.written
