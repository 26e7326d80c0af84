"""Three servos in virtual time, a port to them, and the monitor between: where daemons are tried."""

import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from tests.proof.busmon.limits import Limits
from tests.proof.busmon.monitor import Monitor
from tests.proof.evil.daemon_life import Over
from tests.proof.evil.good import Good
from twind_drivers.dynamixel.servo_twin import FIRMWARE, settings
from twind_drivers.virtual.servo_physics import FirstOrderPhysics
from twind_drivers.virtual.virtual_serial_bus import VirtualBus
from twind_drivers.virtual.virtual_servos import ServoSpec

BAUD = 2_000_000
START = {1: 2100, 2: 2300, 5: 1900}  # counts, where the shafts stand
AFTER = 0.3  # s that a daemon lives on after it was caught: what else does it break?
ZERO = {1: 2048, 2: 2200, 5: 2000}

ROBOT = """
format: twind-robot/1
name: trio
support: gantry
loop: {rate_hz: 100}
buses: {main: {kind: dynamixel2, baud: 2000000}}
types:
  arm: {device: XM430-W350, mode: position, velocity_limit_rad_s: 4.0, acceleration_limit_rad_s2: 20.0,
        current_limit_a: 1.0}
defaults: {type: arm, bus: main, sign: 1, ratio: 1.0}
joints:
  a: {id: 1, limits_rad: [-1.5, 1.5]}
  b: {id: 2, limits_rad: [-0.7, 0.7], sign: -1, ratio: 2.0, velocity_limit_rad_s: 1.5}
  c: {id: 5, limits_rad: [-1.0, 0.5], stop_rad: {upper: 0.6}}
"""
JOINT = """
  {name}:
    bus: main
    id: {id}
    device: {{model_number: 1020, firmware: 47, eeprom: {{min_ticks: {least}, max_ticks: {most}}}}}
    zero_ticks: {zero}
    sign: {sign}
    sweep_ticks: [{first}, {last}]
"""


def files(folder: Path) -> tuple[Path, Path]:
    """Robot and calibration file of the three."""
    robot = folder / "trio.yaml"
    calibration = folder / "calibration.yaml"
    robot.write_text(ROBOT)
    rows = (("a", 1, 1, 900, 3200), ("b", 2, -1, 1100, 3300), ("c", 5, 1, 1250, 2450))
    text = "format: twind-calibration/1\njoints:"
    for name, id, sign, first, last in rows:
        text += JOINT.format(
            name=name, id=id, sign=sign, zero=ZERO[id], first=first, last=last, least=first, most=last
        )
    calibration.write_text(text)
    return robot, calibration


def limits() -> Limits:
    """As the monitor reads them."""
    with tempfile.TemporaryDirectory() as folder:
        return Limits.read(*files(Path(folder)), "main")


def bus(now: float = 0.0) -> VirtualBus:
    """The servos, torque off, wherever they were left."""
    made = settings(BAUD, 10) | {"operating_mode": 3}
    spans = {1: (900, 3200), 2: (1100, 3300), 5: (1250, 2450)}
    servos = [
        ServoSpec(id, "XM430-W350", made | {"min_position_limit": low, "max_position_limit": high}, FIRMWARE)
        for id, (low, high) in spans.items()
    ]
    return VirtualBus(
        "main", servos, FirstOrderPhysics(np.array(list(START.values()), np.float64), now=now), baud=BAUD
    )


class VirtualPort:
    """A daemon's way to the servos, through the monitor. Time passes where the daemon waits."""

    def __init__(self, limits: Limits, *, writes: bool = True, monitor: type[Monitor] = Monitor) -> None:
        self.monitor = monitor(limits, writes=writes)
        self.bus = bus()
        self.now = 0.0

    def write(self, data: bytes) -> None:
        wrong = self.monitor.violations
        if wrong and self.now > wrong[0].time + AFTER:
            raise Over
        self.monitor.sent(data, self.now)
        self.bus.receive(data, self.now)

    def read(self, count: int, timeout: float) -> bytes:
        """`count` bytes, or what came within `timeout` s."""
        data = b""
        end = self.now + timeout
        while len(data) < count:
            if self.bus.next_output_time() > end:
                self.now = end
                break
            self.now = max(self.now, self.bus.next_output_time())
            came = self.bus.take(self.now)
            self.monitor.answered(came, self.now)
            data += came
        return data

    def until(self, time: float) -> None:
        while self.now < time:
            self.now = min(self.now + 0.01, time)
            self.monitor.look(self.now)
        self.bus.advance(self.now)

    def say(self, what: str, **facts: Any) -> None:
        self.monitor.take_report(what, self.now, **facts)

    def ask_servos(self) -> None:
        """Report the velocities of the servos, for W11."""
        self.bus.advance(self.now)
        velocity = dict(zip(START, self.bus.servos.muscles.velocity.tolist(), strict=True))
        self.say("servos", velocity=velocity)


def tried(daemon: type[Good], limits: Limits, monitor: type[Monitor] = Monitor) -> Monitor:
    """A daemon's life, or what is left of it after it was caught; its monitor."""
    port = VirtualPort(limits, monitor=monitor)
    with suppress(Over, AssertionError):  # servos that it has spoilt answer wrongly
        daemon(port, limits).live()
    return port.monitor
