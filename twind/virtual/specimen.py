"""One virtual specimen of a robot file: where each servo's zero is, how its EEPROM is set, what fits it.

Runs in `twind-virtual`. The zeros differ from servo to servo, so that a missing or wrong calibration shows.
"""

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from twind.config.actuator import CAN, SERIAL, ServoType
from twind.config.calibration_file import SWEEP_MARGIN, Calibration, fitting, save_calibration
from twind.config.counts import tick_range, ticks_of, turn_start
from twind.config.robot_spec import BusSpec, JointSpec, RobotFile
from twind.twin.base_pose import UPRIGHT
from twind.twin.muscles import MujocoMuscles, body_of
from twind.version import __version__
from twind.virtual.bench import (
    FIRMWARE,
    Line,
    SpecimenError,
    can_bus,
    laid_out,
    settings,
    virtual_bus,
)
from twind.virtual.nodes import device, node, unloaded
from twind_drivers.bus import Device
from twind_drivers.dynamixel.tables import number_of, table
from twind_drivers.virtual.can.muscles import CanMuscles
from twind_drivers.virtual.can.spec import NodeSpec
from twind_drivers.virtual.muscles import FirstOrder, Muscles
from twind_drivers.virtual.served import Served
from twind_drivers.virtual.servos import BAUDS, ServoSpec

SCATTER = 400  # ticks either side of the middle of what the travel allows
SEAM = 32  # ticks that the travel keeps from the seam of the encoder


@dataclass(frozen=True)
class Specimen:
    """A robot file and the truth about one robot built after it."""

    robot: RobotFile
    zeros: Mapping[str, int]  # ticks at joint angle 0, by joint
    servos: Mapping[str, tuple[ServoSpec, ...]]  # by serial bus, in joint order
    nodes: Mapping[str, tuple[NodeSpec, ...]] = field(default_factory=dict)  # by CAN bus, likewise

    def joints(self, bus: str) -> list[JointSpec]:
        """The joints of one bus, in order."""
        return [joint for joint in self.robot.joints if joint.bus == bus]


def specimen(
    robot: RobotFile,
    *,
    baud: int | None = None,
    return_delay_us: int | None = None,
    firmware: int = FIRMWARE,
) -> Specimen:
    """Servos that a robot file describes. Raises SpecimenError: rate, delay or travel that they cannot do."""
    zeros = {joint.name: _zero(robot.name, joint) for joint in robot.joints}
    on = {bus.name: [joint for joint in robot.joints if joint.bus == bus.name] for bus in robot.buses}
    servos = {
        bus.name: tuple(
            _servo(joint, zeros[joint.name], baud or bus.baud, return_delay_us, firmware)
            for joint in on[bus.name]
        )
        for bus in robot.buses
        if bus.kind == SERIAL
    }
    nodes = {bus.name: tuple(map(node, on[bus.name])) for bus in robot.buses if bus.kind == CAN}
    return Specimen(robot, zeros, servos, nodes)


def _zero(robot: str, joint: JointSpec) -> int:
    """The same for the same names: somewhere that keeps the travel on one turn, clear of the seam."""
    turn, start = joint.type.ticks_per_turn, turn_start(joint.type)
    low, high = tick_range(joint, 0, joint.lower - SWEEP_MARGIN, joint.upper + SWEEP_MARGIN)
    first, last = start + SEAM - low, start + turn - 1 - SEAM - high
    if first > last:
        raise SpecimenError(f"{joint.name}: travel of {high - low} ticks does not fit one turn of {turn}")
    middle = (first + last) // 2
    first, last = max(first, middle - SCATTER), min(last, middle + SCATTER)
    return first + zlib.crc32(f"{robot}/{joint.name}".encode()) % (last - first + 1)


def _servo(joint: JointSpec, zero: int, baud: int, return_delay_us: int | None, firmware: int) -> ServoSpec:
    assert isinstance(joint.type, ServoType)
    delay = joint.type.return_delay_us if return_delay_us is None else return_delay_us
    low, high = tick_range(joint, zero, joint.lower - SWEEP_MARGIN, joint.upper + SWEEP_MARGIN)
    made = settings(baud, delay) | {
        "operating_mode": joint.operating_mode,
        "min_position_limit": low,
        "max_position_limit": high,
    }
    return ServoSpec(joint.id, joint.type.device, made | dict(joint.registers), firmware)


def calibration(made: Specimen) -> Calibration:
    """The calibration file that fits: what a perfect calibration of these servos would have found."""
    devices = {(bus, servo.id): _device(servo) for bus, servos in made.servos.items() for servo in servos}
    devices |= {(bus, each.id): device(each) for bus, nodes in made.nodes.items() for each in nodes}
    created = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    return fitting(made.robot, made.zeros, devices, created=created, tool=f"twind-virtual {__version__}")


def save(made: Specimen, path: Path) -> None:
    """Write that file. Raises ConfigError, OSError, SpecimenError (not a `.yaml`)."""
    if path.suffix != ".yaml":
        raise SpecimenError(f"{path}: a calibration file is named NAME.yaml")
    save_calibration(calibration(made), path.parent, path.stem)


def _device(servo: ServoSpec) -> Device:
    number = number_of(servo.model)
    registers = table(number, servo.firmware)
    keys = ("homing_offset", "drive_mode", "operating_mode", "min_position_limit", "max_position_limit")
    settings = {key: registers[key].rule.default or 0 for key in keys} | dict(servo.settings)
    return Device(servo.id, number, registers.model, servo.firmware, settings)


def buses(
    made: Specimen,
    *,
    physics: bool = True,
    base: str = UPRIGHT,
    now: float = 0.0,
    line: Line | None = None,
    extra: Mapping[str, Sequence[ServoSpec]] | None = None,
) -> dict[str, Served]:
    """The buses of a specimen, in its rest pose with torque off. One body moves all of them.

    `base`: how that is held, of `base_pose.BASES`. `extra`: servos beside those of the robot, by serial bus.
    Raises SpecimenError for a bus that the robot has not, and with `physics`: the body knows nothing of them.
    """
    extra = extra or {}
    strange = sorted(set(extra) - set(made.servos))
    if strange:
        why = (
            "is a CAN bus: only a serial one takes servos beside its own" if strange[0] in made.nodes else ""
        )
        known = f"no bus {strange[0]!r}; {made.robot.name} has {', '.join(made.servos)}"
        raise SpecimenError(f"{strange[0]} {why}" if why else known)
    if extra and physics:
        raise SpecimenError("servos beside those of a robot have no body: say --muscles first-order")
    line = line or Line()
    body = body_of(made.robot, made.zeros, base=base, now=now) if physics else None
    virtual: dict[str, Served] = {}
    for spec in made.robot.buses:
        if spec.kind == CAN:
            moved = _can_muscles(made, spec, body, now)
            virtual[spec.name] = can_bus(
                spec.name, made.nodes[spec.name], moved, line, bitrate=spec.baud, now=now
            )
            continue
        own = made.servos[spec.name]
        beside, stand = laid_out(extra.get(spec.name, ()), line.seed)
        baud = BAUDS[own[0].settings["baud_rate"]] if own else spec.baud
        muscles = _muscles(made, spec, body, now, stand)
        virtual[spec.name] = virtual_bus(spec.name, [*own, *beside], muscles, line, baud=baud, now=now)
    return virtual


def _muscles(
    made: Specimen, bus: BusSpec, body: MujocoMuscles | None, now: float, beside: list[float]
) -> Muscles:
    """Those of one bus; `beside`: ticks where servos stand that belong to no joint."""
    if body is not None:
        return body.part(_places(made, bus))
    return FirstOrder(np.array([*map(float, _start(made, bus)), *beside]), now=now)


def _can_muscles(made: Specimen, bus: BusSpec, body: MujocoMuscles | None, now: float) -> CanMuscles:
    if body is not None:
        return body.impedance(_places(made, bus))
    return unloaded(_start(made, bus), now=now)


def _places(made: Specimen, bus: BusSpec) -> list[int]:
    """Of the joints of a bus, in joint order."""
    return [at for at, joint in enumerate(made.robot.joints) if joint.bus == bus.name]


def _start(made: Specimen, bus: BusSpec) -> list[int]:
    """Counts of the joints of a bus in the rest pose."""
    rest = made.robot.poses["rest"]
    return [ticks_of(joint, made.zeros[joint.name], rest[joint.name]) for joint in made.joints(bus.name)]
