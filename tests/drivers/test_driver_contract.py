"""Every driver and every family of actuators, by the one contract (`driver_contract`)."""

from collections.abc import Callable

import numpy as np
import pytest

from tests.support.can_driver_rig import CanRig
from tests.support.driver_contract_claims import DriverContract
from tests.support.driver_rig import DriverRig, both
from tests.support.dynamixel1_rig import QUICK, Dynamixel1Rig
from tests.support.feetech_rig import Counted, FeetechRig
from tests.support.unwatched_rig import UnwatchedRig
from tests.support.virtual_serial_host import Host
from twind_drivers.dynamixel.dynamixel_reader import DynamixelReader
from twind_drivers.dynamixel.dynamixel_writer import DynamixelWriter
from twind_drivers.dynamixel1.virtual_dynamixel1_spec import Dynamixel1ServoSpec
from twind_drivers.feetech.virtual_feetech_spec import FeetechServoSpec


class DynamixelRig(DriverRig):
    """Four servos at tick 2048."""

    def __init__(self) -> None:
        self.name = "dynamixel2"
        self.host = Host((1, 2, 3, 4))
        self.clock = self.host.clock
        self.faults = self.host.bus.faults
        self.port = Counted(self.host.bus, self.clock)
        self.lower = np.zeros(4, np.int64)
        self.upper = np.full(4, 4095, np.int64)
        self.reader: DynamixelReader = DynamixelReader(
            "arm", self.port, (1, 2, 3, 4), [1020] * 4, baud=2_000_000, return_delay_us=0
        )
        self.writer: DynamixelWriter = DynamixelWriter(self.reader, lower=self.lower, upper=self.upper)

    def places(self) -> np.ndarray:
        return np.rint(self.host.muscles.position).astype(np.int64)

    def energised(self) -> np.ndarray:
        return np.array([bool(on) for on in self.host.servos["torque_enable"]])

    def sent(self) -> int:
        return self.port.written


RIGS: dict[str, Callable[[], DriverRig]] = {
    "dynamixel": DynamixelRig,
    "feetech": FeetechRig,
    "scs": lambda: FeetechRig([FeetechServoSpec(id, "SCS0009") for id in (1, 2, 3)]),
    "dynamixel1": Dynamixel1Rig,
    "ax": lambda: Dynamixel1Rig([Dynamixel1ServoSpec(id, "AX-12A", QUICK) for id in (1, 2, 3)]),
    "xl320": lambda: UnwatchedRig(["XL-320"] * 3),
    "pro_r": lambda: UnwatchedRig(["H54-200-S500-R", "H42-20-S300-R", "M54-60-S250-R"]),
    "hls": lambda: FeetechRig([FeetechServoSpec(id, "HLS3955") for id in (1, 2)]),
    "smbl": lambda: FeetechRig([FeetechServoSpec(id, "SM8512BL") for id in (1, 2)]),
    "damiao": lambda: CanRig(("DM4310", "DM4340", "DM8009")),
    "robstride": lambda: CanRig(("RS01", "RS02", "RS00")),
    "cubemars": lambda: CanRig(("AK80-9", "AK70-10")),
    "odrive": lambda: CanRig(("ODrive", "ODrive")),
    "mixed": lambda: CanRig(("DM4310", "RS02", "AK70-10", "ODrive")),
}


@pytest.fixture(
    params=[pytest.param(name, marks=pytest.mark.slow if name == "mixed" else ()) for name in RIGS]
)
def fresh(request: pytest.FixtureRequest) -> Callable[[], DriverRig]:
    return RIGS[request.param]


@pytest.fixture
def rig(fresh: Callable[[], DriverRig]) -> DriverRig:
    return fresh()


class TestContract(DriverContract):
    pass


def test_a_dynamixel_bus_armed_after_a_dead_writer_does_not_resume_the_old_goal() -> None:
    rig = DynamixelRig()
    here = rig.arm()
    rig.ticks(5, here + 900)
    rig.clock.sleep_until(rig.clock.now() + 0.5)
    stopped = rig.tick().position
    assert rig.host.servos.tripped.all()
    rig.beside(both(rig, stopped))
    assert not rig.host.servos.tripped.any()
    rig.ticks(20, stopped)
    assert np.abs(rig.places() - stopped).max() < 25, "the old goal acts for at most 1 ms"
