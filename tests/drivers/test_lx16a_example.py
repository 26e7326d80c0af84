"""A driver family of a third party: installed from outside, it passes the driver contract."""

from collections.abc import Callable, Iterator
from importlib import import_module

import numpy as np
import pytest

from tests.support.driver_contract_claims import DriverContract
from tests.support.driver_rig import DriverRig
from tests.support.feetech_rig import Counted
from tests.support.third_party_family import installed_family
from twind.config.driver_family import kinds
from twind_drivers.clock import FakeClock
from twind_drivers.virtual.servo_physics import FirstOrderPhysics


class LxRig(DriverRig):
    """Three LX-16A in the middle of their travel, limp."""

    rate_hz = 50.0
    stroke = 100.0

    def __init__(self) -> None:
        self.name = "lx16a"
        twin = import_module("twind_lx16a.lx16a_twin")
        self.muscles = FirstOrderPhysics(np.array([500.0, 480.0, 520.0]))
        self.bus = twin.VirtualLxBus("test", [twin.LxServoSpec(id) for id in (1, 2, 3)], self.muscles)
        self.clock = FakeClock()
        self.faults = self.bus.faults
        self.port = Counted(self.bus, self.clock)
        self.lower = np.zeros(3, np.int64)
        self.upper = np.full(3, 1000, np.int64)
        self.reader = import_module("twind_lx16a.lx16a_reader").LxReader("arm", self.port, (1, 2, 3), 50.0)
        self.writer = import_module("twind_lx16a.lx16a_bus").LxWriter(self.reader, self.lower, self.upper)

    def places(self) -> np.ndarray:
        return np.rint(self.muscles.position).astype(np.int64)

    def energised(self) -> np.ndarray:
        return np.array([each.loaded for each in self.bus.servos])

    def sent(self) -> int:
        return self.port.written


@pytest.fixture(scope="module", autouse=True)
def installed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with installed_family(tmp_path_factory.mktemp("lx16a")):
        yield


@pytest.fixture
def fresh() -> Callable[[], DriverRig]:
    return LxRig


@pytest.fixture
def rig(fresh: Callable[[], DriverRig]) -> DriverRig:
    return fresh()


class TestContract(DriverContract):
    def test_the_hardware_error_is_read_by_its_name(self, rig: DriverRig) -> None:
        """An LX-16A reports no errors, and its driver does not pretend to read one."""
        with pytest.raises(ValueError, match="hardware_error_status"):
            rig.perform(rig.reader.read(1, "hardware_error_status"))


def test_the_family_is_found_by_its_entry_point() -> None:
    assert "lx16a" in kinds()


def test_packets_are_those_of_the_vendor_s_paper() -> None:
    packet = import_module("twind_lx16a.lx16a_packet")
    for id, code, params, octets in (
        (1, 1, "f401e803", "55 55 01 07 01 f4 01 e8 03 16"),
        (1, 28, "", "55 55 01 03 1c df"),
        (1, 28, "f401", "55 55 01 05 1c f4 01 e8"),
        (1, 31, "00", "55 55 01 04 1f 00 db"),
    ):
        assert packet.lx_packet(id, code, bytes.fromhex(params)) == bytes.fromhex(octets)
        (found,) = packet.find_lx_packets(b"\x55" + bytes.fromhex(octets))
        assert found == (id, code, bytes.fromhex(params))
