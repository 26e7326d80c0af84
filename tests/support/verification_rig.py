"""Verification of three joints, tick by tick: their counts, buses and silences are what the test says.

The hip falls back to one turn at torque-on, the knee counts several turns over a short travel, the toe
travels one and a half turns. Hip and knee are on bus `lower`, the toe on `upper`, with an actuator on CAN.
"""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from tests.support.procedure_rig import PERIOD, ProcedureRig
from twind.loop.bus.bus_port import PortState
from twind.loop.procedures.joint_verification import JointVerificationState
from twind.robot.arrays import Bools, Floats
from twind.robot.joint_state import JointState
from twind.robot.measured_travel import MeasuredTravel
from twind.safety.device_rules import DeviceRules
from twind.safety.guard_types import GuardThresholds

HIP, KNEE, TOE = range(3)
WHOLE = 4096
SCALE = 0.001  # rad a count
PLACES = (2000, 1000, 1500)  # calibrated counts at the begin; a turn further the toe is in its travel too
MIDDLE = 3000  # count of the toe, of which no turn beside it is in its travel


def travels() -> MeasuredTravel:
    return MeasuredTravel(
        known=np.array([True, True, True]),
        whole=np.full(3, WHOLE),
        band=np.array([0, -1048, 952]),
        first=np.array([1000, 0, 0]),
        last=np.array([3000, 2000, 6000]),
        slack=np.full(3, 20),
        least=np.array([0, -1_000_000, -1_000_000]),
        most=np.array([4095, 1_000_000, 1_000_000]),
        lower=np.array([1000, 0, 0]),
        upper=np.array([3000, 2000, 6000]),
        falls=np.array([True, False, False]),
        begin=np.zeros(3, np.int64),
    )


class Verifying:
    """The verification of a robot whose buses are not open yet."""

    def __init__(self, period: float = PERIOD) -> None:
        self.rig = rig = ProcedureRig(period=period)
        rig.follows = False
        rig.hardware.slow.torque[:] = 0
        rig.hardware.slow.fault = np.zeros(3, np.int16)
        self.raw = np.array(PLACES, np.int64)  # as read from now on
        self.heard: Bools = np.ones(3, np.bool_)  # who answers
        self.ports = [self._port("lower"), self._port("upper")]
        buses: Any = [SimpleNamespace(joints=np.array(own), linked=()) for own in ([HIP, KNEE], [TOE])]
        rig.hardware.ports = self.ports
        rig.hardware.pairs = tuple(zip(self.ports, buses, strict=True))
        rig.hardware.turn = self._turn
        rig.hardware.connected = False
        self.readings = rig.hardware.readings
        self.readings.alerts = np.zeros(3, np.uint8)
        self.readings.jumps = np.zeros(3, np.int64)
        self.readings.leaps = np.zeros(3)
        self.readings.heard_at = np.full(3, -np.inf)
        self.readings.where = self._where
        rig.hardware.resolution = np.full(3, SCALE)
        rig.robot.joints.turns = travels()
        self.bars: list[Any] = []
        devices = DeviceRules(np.zeros(3, np.bool_), False, GuardThresholds(), can=(TOE,))
        guard: Any = SimpleNamespace(bars=self.bars, devices=devices)
        self.verified = JointVerificationState(rig, guard)
        self.turned: list[int] = []  # buses whose turns were set
        self._read()

    def _port(self, name: str) -> Any:
        port = SimpleNamespace(name=name, link=PortState.CLOSED, holding=False, tasks=[], identified=0)

        def identify() -> None:
            port.identified += 1
            port.link = PortState.IDENTIFYING

        port.identify = identify
        return port

    def _turn(self, number: int, shift: Any) -> None:
        self.turned.append(number)
        self.readings.shift[self.rig.hardware.pairs[number][1].joints] = shift

    def _where(self) -> Floats:
        position: Floats = (self.readings.raw.ticks + self.readings.shift) * SCALE
        return np.where(self.readings.placed, position, np.nan)

    def _read(self) -> None:
        now = self.now
        self.readings.raw.ticks[:] = np.where(self.heard, self.raw, self.readings.raw.ticks)
        self.readings.heard_at[:] = np.where(self.heard, now, self.readings.heard_at)
        still = np.zeros(3)
        age = now - self.readings.heard_at
        self.rig.robot.measured = JointState(now, self._where(), still, still, age, self.heard.copy())

    @property
    def now(self) -> float:
        return self.rig.clock.now()

    def tick(self, count: int = 1) -> None:
        for _ in range(count):
            self.rig.clock.sleep_until(self.now + self.rig.robot.period)
            self._read()
            self.verified.watch(self.now)

    def identify(self, *buses: int, fits: Sequence[bool] = (True, True)) -> None:
        """All devices of these buses (else of all) are identified in this tick; `fits`: of `lower`."""
        self.rig.clock.sleep_until(self.now + self.rig.robot.period)
        self._read()
        for number in buses or (0, 1):
            port, bus = self.rig.hardware.pairs[number]
            mine = np.array(fits if number == 0 else [True], np.bool_)
            self.verified.identified(port, bus, mine)
            port.link = PortState.CONNECTED if mine.all() else PortState.IDENTIFYING
        self.rig.hardware.connected = all(port.link is PortState.CONNECTED for port in self.ports)
        self.verified.watch(self.now)

    def identified(self) -> "Verifying":
        """Opened, identified, and read for some ticks; the turn of the toe is not known."""
        for port in self.ports:
            port.link = PortState.IDENTIFYING
        self.tick(2)
        self.identify()
        self.tick(3)
        return self

    def hold(self) -> None:
        """Every joint has torque."""
        for port in self.ports:
            port.holding = True
        self.rig.hardware.holding = True
        self.rig.hardware.slow.torque[:] = 1
        self.rig.torque.take_hold(np.ones(3, np.bool_))

    def let_go(self) -> None:
        """Torque is off everywhere."""
        for port in self.ports:
            port.holding = False
        self.rig.hardware.holding = False
        self.rig.hardware.slow.torque[:] = 0
        self.rig.torque.begin_release()
        self.rig.torque.confirm_off()

    @property
    def joints(self) -> list[bool]:
        return [bool(each) for each in self.verified.joints]

    @property
    def known(self) -> list[bool]:
        return [bool(each) for each in self.verified.turn_known]

    @property
    def places(self) -> list[float]:
        """Calibrated counts as the robot reports them; NaN: unknown."""
        counts: list[float] = np.round(self.rig.robot.measured.position / SCALE).tolist()
        return counts


def at_middle() -> Verifying:
    """Identified and read, all turns known."""
    robot = Verifying()
    robot.raw[TOE] = MIDDLE
    robot.identified()
    assert robot.joints == [True] * 3
    return robot
