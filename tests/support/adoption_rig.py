"""A robot file of few servos and its bus under a fake clock: who is there, and a port that dies when told."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from twind.config.device_check import check_devices
from twind.config.robot_file import read_robot
from twind.config.robot_spec import RobotFile
from twind_calibration.calibrating.calibration_draft import CalibrationDraft
from twind_drivers.clock import FakeClock
from twind_drivers.dynamixel.dynamixel_reader import DynamixelReader
from twind_drivers.dynamixel.dynamixel_tools import PROTOCOL
from twind_drivers.dynamixel.packet import Framer, Instruction
from twind_drivers.run_script import perform
from twind_drivers.servo_tools.adoption.adoption_steps import AdoptionPlan, prepare
from twind_drivers.servo_tools.adoption.calibration_entry_status import CalibrationEntryStatus
from twind_drivers.servo_tools.adoption.candidate_locations import choose, look
from twind_drivers.servo_tools.servo_configurator import WritableProber
from twind_drivers.virtual.serial_loopback import Loopback
from twind_drivers.virtual.servo_physics import FirstOrderPhysics
from twind_drivers.virtual.virtual_serial_bus import VirtualBus
from twind_drivers.virtual.virtual_servos import BAUDS, ServoSpec

BAUD = 1_000_000
TEXT = """\
format: twind-robot/1
name: bench
model: {{mjcf: arm.xml, base: torso}}
support: gantry
buses:
  main: {{kind: dynamixel2, baud: {baud}}}
types:
  small: {{{kind}, return_delay_us: 20, gains: {{p: 800, i: 0, d: 0}}}}
defaults: {{type: small, bus: main}}
joints:
{joints}
poses: {{rest: {{}}}}
"""


KIND = "device: XM430-W350, registers: {shutdown: 53, current_limit: 600}"


def robot_of(
    folder: Path, ids: Mapping[str, int], *, baud: int = BAUD, more: str = "", kind: str = KIND
) -> RobotFile:
    """A robot with these joints; `more`: what each says beside its id; `kind`: what their type says."""
    (folder / "arm.xml").write_text("<mujoco/>")
    joints = "\n".join(f"  {name}: {{id: {id}, limits_rad: [-1, 1]{more}}}" for name, id in ids.items())
    path = folder / "bench.yaml"
    path.write_text(TEXT.format(baud=baud, joints=joints, kind=kind))
    return read_robot(path)


class Killed(Exception):
    """This program was ended here."""


class Port(Loopback):
    """A port with a rate. `left` writes that change a servo pass, then the program dies before the next."""

    def __init__(self, bus: VirtualBus, clock: FakeClock) -> None:
        super().__init__(bus, clock)
        self.wire = bus
        self.clock = clock
        self.left: float = np.inf
        self.after = False  # die after the write instead
        self.writes: list[tuple[int, int]] = []  # id, address

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """As the loopback, counting."""
        orders = [each for each in Framer(status=False).feed(data) if each.instruction == Instruction.WRITE]
        if orders and not self.after and self.left <= 0:
            raise Killed
        super().write(data)
        for each in orders:
            self.writes.append((each.id, int.from_bytes(each.params[:2], "little")))
            self.left -= 1
        if orders and self.after and self.left < 0:
            self.clock.sleep_until(self.clock.now() + 0.01)
            self.wire.advance(self.clock.now())
            raise Killed

    def at(self, baud: int) -> WritableProber:
        """The line at a rate."""
        self.wire.line(baud)
        return WritableProber(self, self.clock, baud, PROTOCOL)


def settled(id: int, **settings: int) -> ServoSpec:
    """A servo that has its place on the robot's bus."""
    return ServoSpec(id, "XM430-W350", {"baud_rate": BAUDS.index(BAUD), "return_delay_time": 10, **settings})


def fresh(id: int = 1, model: str = "XM430-W350", firmware: int = 47, **settings: int) -> ServoSpec:
    """A servo as delivered, but for `settings`."""
    return ServoSpec(id, model, settings, firmware)


def uncalibrated(robot: RobotFile, joint: str) -> CalibrationEntryStatus:
    """State of a joint that has no calibration."""
    return CalibrationEntryStatus(robot, Path("bench.yaml"), None, CalibrationDraft(), joint)


class Bench:
    """Servos on a wire, each at another count and powered at another time."""

    def __init__(self, robot: RobotFile, specs: Sequence[ServoSpec]) -> None:
        self.robot = robot
        self.clock = FakeClock()
        count = len(specs)
        given = [
            ServoSpec(s.id, s.model, s.settings, s.firmware, powered=1.0 + 0.37 * k)
            for k, s in enumerate(specs)
        ]
        muscles = FirstOrderPhysics(np.arange(count) * 97.0 + 2000.0)
        self.bus = VirtualBus("main", given, muscles, baud=robot.buses[0].baud)
        self.port = Port(self.bus, self.clock)

    def look(
        self, name: str | None = None, entry: CalibrationEntryStatus | None = None
    ) -> AdoptionPlan | None:
        """Findings of `twindctl adopt` before it asks."""
        bus = self.robot.buses[0]
        heard = {bus.name: look(self.port.at, self.robot, bus)}
        chosen = choose(self.robot, heard, name)
        if chosen is None:
            return None
        return prepare(chosen, self.port.at, entry or uncalibrated(self.robot, chosen.joint.name))

    def adopt(
        self, name: str | None = None, entry: CalibrationEntryStatus | None = None
    ) -> AdoptionPlan | None:
        """All of it."""
        adoption = self.look(name, entry)
        if adoption is not None and not adoption.nothing:
            adoption.carry_out()
        return adoption

    def killed(self, writes: int, name: str, *, after: bool) -> bool:
        """Begin, and end this program at a write; False: it had come to its end before."""
        self.port.left = writes
        self.port.after = after
        try:
            self.adopt(name)
        except Killed:
            return True
        finally:
            self.port.left = np.inf
        return False

    def power_cycle(self) -> None:
        """Everybody loses the supply, and gets it back."""
        self.bus.faults.power(on=False)
        self.rest(0.5)
        self.bus.faults.power(on=True)
        self.rest(0.5)

    def rest(self, seconds: float) -> None:
        """Let time pass."""
        self.clock.sleep_until(self.clock.now() + seconds)
        self.bus.advance(self.clock.now())

    def value(self, row: int, name: str) -> int:
        """True value of a servo's register."""
        memory = self.bus.servos.memory
        return memory.value(row, memory.tables[row][name])

    def eeprom(self, row: int) -> bytes:
        """All of what a servo keeps without power."""
        return bytes(self.bus.servos.memory.raw[row, :64])


def is_home(bench: Bench, row: int) -> bool:
    """At its place, as live start asks, without torque."""
    reader = DynamixelReader("main", bench.port, (7,), (1020,), baud=BAUD, return_delay_us=500)
    bench.bus.line(BAUD)
    devices = perform(reader, reader.identify(), bench.clock)
    one = {("main", each.id): each for each in devices}
    found = check_devices(bench.robot, one)
    wrist = bench.robot.names.index("wrist")
    wrong = [each for each in (*found.refusals, *found.warnings) if each.joint == wrist]
    return not wrong and bench.value(row, "torque_enable") == 0 and bench.value(row, "id") == 7


def there(adoption: AdoptionPlan | None) -> AdoptionPlan:
    assert adoption is not None
    return adoption


__all__ = ["BAUD", "Bench", "Killed", "fresh", "is_home", "robot_of", "settled", "there"]
