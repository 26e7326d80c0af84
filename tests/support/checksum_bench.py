"""Virtual servos with the framing `FF FF` on one port, under a fake clock, and a robot file for them."""

from collections.abc import Mapping
from math import inf
from pathlib import Path

import numpy as np

from twind.config.robot_file import read_robot
from twind.config.robot_spec import RobotFile
from twind.doctor.host_inspector import HostInspector
from twind_drivers.clock import FakeClock
from twind_drivers.dynamixel1.virtual_dynamixel1_bus import VirtualDynamixel1Bus
from twind_drivers.dynamixel1.virtual_dynamixel1_spec import Dynamixel1ServoSpec
from twind_drivers.feetech.virtual_feetech_bus import VirtualFeetechBus
from twind_drivers.feetech.virtual_feetech_spec import FeetechServoSpec
from twind_drivers.servo_tools.doctor.serial_bus_inspector import SerialBusInspector
from twind_drivers.servo_tools.family_tools import FamilyTools, need_tools
from twind_drivers.servo_tools.servo_configurator import WritableProber
from twind_drivers.virtual.faulty_byte_stream import SerialAdapter
from twind_drivers.virtual.serial_loopback import Loopback
from twind_drivers.virtual.servo_physics import FirstOrderPhysics

MILLION = 1_000_000
Spec = FeetechServoSpec | Dynamixel1ServoSpec
TEXT = """\
format: twind-robot/1
name: bench
model: {{mjcf: arm.xml, base: torso}}
support: gantry
buses:
  main: {{kind: {kind}, baud: {baud}}}
types:
  small: {{device: {device}, watchdog: none{more}}}
defaults: {{type: small, bus: main}}
joints:
{joints}
poses: {{rest: {{}}}}
"""


def robot_of(
    folder: Path,
    kind: str,
    device: str,
    ids: Mapping[str, int],
    *,
    baud: int = MILLION,
    more: str = "",
    joint: str = "",
) -> RobotFile:
    """A robot with these joints; `more`: what their type says; `joint`: what each joint says."""
    (folder / "arm.xml").write_text("<mujoco/>")
    joints = "\n".join(f"  {name}: {{id: {id}, limits_rad: [-1, 1]{joint}}}" for name, id in ids.items())
    path = folder / "bench.yaml"
    path.write_text(TEXT.format(kind=kind, device=device, baud=baud, joints=joints, more=more))
    return read_robot(path)


class Killed(BaseException):
    """This program was ended here."""


class BenchPort(Loopback):
    """A port with a rate, and the ids and addresses of all writes to single servos."""

    latency_ms = None
    warning = None

    def __init__(self, bus: VirtualFeetechBus | VirtualDynamixel1Bus, clock: FakeClock) -> None:
        super().__init__(bus, clock)
        self.wire = bus
        self.writes: list[tuple[int, int]] = []
        self.left = inf  # writes until the program dies

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """As the loopback, counting."""
        if data[4] == 3:
            if self.left <= 0:
                raise Killed
            self.left -= 1
            self.writes.append((data[2], data[5]))
        super().write(data)

    def set_baud(self, baud: int) -> None:
        """The line at a rate."""
        self.wire.line(baud)


class ChecksumBench:
    """Servos of one family on a wire, each at another count."""

    def __init__(self, *specs: Spec, adapter: SerialAdapter | None = None) -> None:
        self.clock = FakeClock(20.0)
        muscles = FirstOrderPhysics(1000.0 - 90.0 * np.arange(len(specs)))
        feetech = [each for each in specs if isinstance(each, FeetechServoSpec)]
        dynamixel = [each for each in specs if isinstance(each, Dynamixel1ServoSpec)]
        self.bus: VirtualFeetechBus | VirtualDynamixel1Bus
        if feetech:
            self.bus = VirtualFeetechBus("main", feetech, muscles, now=20.0, adapter=adapter)
        else:
            self.bus = VirtualDynamixel1Bus(
                "main", dynamixel, muscles, baud=MILLION, now=20.0, adapter=adapter
            )
        self.port = BenchPort(self.bus, self.clock)
        self.tools: FamilyTools = need_tools(self.bus.kind)

    def at(self, baud: int) -> WritableProber:
        """Prober at a rate."""
        self.bus.line(baud)
        return WritableProber(self.port, self.clock, baud, self.tools.protocol)

    def inspector(self) -> SerialBusInspector:
        """Inspector of the doctor, on this port."""
        found = SerialBusInspector("bench", MILLION, HostInspector(), self.clock, self.tools)
        found.__dict__["transport"] = self.port
        return found

    def value(self, row: int, name: str) -> int:
        """True value of a register."""
        return self.bus.servos.get(row, name)


def feetech(id: int = 1, model: str = "STS3215", **settings: int) -> FeetechServoSpec:
    """A Feetech servo as delivered, but for `settings`."""
    return FeetechServoSpec(id, model, settings)


def dynamixel1(id: int = 1, model: str = "AX-12A", **settings: int) -> Dynamixel1ServoSpec:
    """A Dynamixel of Protocol 1.0 as delivered, but for `settings`."""
    return Dynamixel1ServoSpec(id, model, settings)
