"""True values of one virtual robot that are in no file of it: a calibration has to find them out.

`--truth FILE` is a mapping `joints:` of joint names to the keys of `JointTruth`. Keys left out are as the
robot file describes them. In process the same data are these dataclasses.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np

from twind.config.actuator_types import CanType
from twind.config.config_section import ConfigSection
from twind.config.counts import ticks_of, turn_start
from twind.config.robot_spec import JointSpec, RobotFile
from twind.config.yaml_tree import parse, read_text
from twind.exceptions import InvalidInput
from twind.twin.mujoco_physics import ranges_of
from twind_drivers.dynamixel.control_tables import number_of, table

MAX_TICKS = 2**31 - 1
OF_CAN = ("zero_ticks", "sign", "stops_rad", "friction_nm")  # what a truth can say of a CAN actuator
FLOATS = ("friction_nm", "backlash_ticks")
LOOSE = (0.02, 0.08)  # rad, how far beyond the limits the stops of a random specimen are
# N·m; ticks; turns either way
RUBBING = (0.03, 0.1)
PLAY = 4.0
WOUND = 2
CLEAR = 8  # ticks from the seam that the travel of a random mode 3 joint keeps


@dataclass(frozen=True, slots=True)
class JointTruth:
    """One joint and its actuator. Counts are the bare encoder's, before direction, turns and offset."""

    zero_ticks: int | None = None  # at joint angle 0, anywhere; None: scattered, clear of the seam
    sign: int | None = None  # +1, -1: how the bare encoder counts; None: as the robot file says
    stops_rad: tuple[float, float] | None = (
        None  # mechanical ends of the joint; None: as described, else the model's
    )
    friction_nm: float | None = None  # dry; None: the model's. Joints without load have none
    backlash_ticks: float = 0.0  # play between encoder and joint, from one side to the other
    turns: int = 0  # the count starts off by so many, until it is lost
    swapped_with: str = ""  # a joint of the same bus whose servo has this one's id, and the other way round
    homing_offset: int = 0  # register 20
    drive_mode: int | None = None  # register 10; None: the robot file's, else as delivered
    startup_configuration: int = 0  # register 60
    tag: int | None = None  # moving threshold (24): the stamp of a calibration
    registers: Mapping[str, int] = field(default_factory=dict)  # of the EEPROM, over all others
    firmware: int | None = None
    forgets_offset: bool = False  # see `ServoSpec`
    seam_seed: int | None = None  # see `ServoSpec`

    def eeprom(self) -> dict[str, int]:
        """Registers that differ from a servo's that is set as the robot file says."""
        found = {"homing_offset": self.homing_offset, "startup_configuration": self.startup_configuration}
        made = {key: value for key, value in found.items() if value}
        if self.drive_mode is not None:
            made["drive_mode"] = self.drive_mode
        if self.tag is not None:
            made["moving_threshold"] = self.tag
        return made | dict(self.registers)

    def non_default_keys(self) -> list[str]:
        """Return the keys whose values differ from the default."""
        return [each.name for each in fields(self) if getattr(self, each.name) != getattr(PLAIN, each.name)]


PLAIN = JointTruth()


@dataclass(frozen=True)
class Truth:
    """Truth of each joint, by name; a joint that is not in it is plain."""

    joints: Mapping[str, JointTruth] = field(default_factory=dict)

    def joint_truth(self, name: str) -> JointTruth:
        """Return the truth of one joint; the plain one if the file does not name it."""
        return self.joints.get(name, PLAIN)

    def holder(self, name: str) -> str:
        """The joint whose servo carries the id that belongs to `name`: itself, unless ids are exchanged."""
        other = self.joint_truth(name).swapped_with
        return other or next((one for one, each in self.joints.items() if each.swapped_with == name), name)


def load_truth(path: Path, robot: RobotFile) -> Truth:
    """The truth in a file, YAML or JSON. Raises ConfigError: unreadable, unknown key, no such joint."""
    top = ConfigSection(str(path), parse(read_text(path), str(path)))
    section = top.section("joints")
    joints = {
        joint.name: _joint(section.section(joint.name)) for joint in robot.joints if section.has(joint.name)
    }
    section.close(also=robot.names)
    top.close()
    return Truth(joints)


def _joint(section: ConfigSection) -> JointTruth:
    made: dict[str, object] = {}
    ticks = {"least": -MAX_TICKS, "most": MAX_TICKS}
    byte = {"least": 0, "most": 255}
    bounds = {
        "zero_ticks": ticks,
        "sign": {"least": -1, "most": 1},
        "turns": {"least": -1000, "most": 1000},
        "homing_offset": ticks,
        "drive_mode": byte,
        "startup_configuration": byte,
        "tag": {"least": 0, "most": 1023},
        "firmware": byte,
        "seam_seed": {"least": 0},
    }
    made |= {key: section.integer(key, **bound) for key, bound in bounds.items() if section.has(key)}
    if made.get("sign") == 0:
        raise section.refuse("sign", "0 is neither 1 nor -1")
    made |= {key: section.number(key, least=0.0) for key in FLOATS if section.has(key)}
    if section.has("stops_rad"):
        low, high = section.numbers("stops_rad", 2)
        if not low < high:
            raise section.refuse("stops_rad", f"{low:g} is not below {high:g}")
        made["stops_rad"] = (low, high)
    if section.has("swapped_with"):
        made["swapped_with"] = section.text("swapped_with")
    if section.has("forgets_offset"):
        made["forgets_offset"] = section.flag("forgets_offset")
    registers = section.section("registers")
    made["registers"] = {key: registers.integer(key, **ticks) for key in registers}
    section.close()
    return JointTruth(**made)  # type: ignore[arg-type]


def refuse_impossible(robot: RobotFile, truth: Truth) -> None:
    """Raises InvalidInput: no such joint, what a CAN actuator has not, servos that cannot be exchanged."""
    specs = {joint.name: joint for joint in robot.joints}
    for name, each in truth.joints.items():
        if name not in specs:
            raise InvalidInput(f"truth: {robot.name} has no joint {name!r}; it has {', '.join(specs)}")
        strange = [key for key in each.non_default_keys() if key not in OF_CAN]
        if isinstance(specs[name].type, CanType) and strange:
            why = f"{strange[0]} is of serial servos; a CAN actuator has {', '.join(OF_CAN)}"
            raise InvalidInput(f"truth: {name}: {why}")
        other = specs.get(each.swapped_with or name)
        if other is None or other.bus != specs[name].bus or each.swapped_with == name:
            raise InvalidInput(
                f"truth: {name}: swapped_with {each.swapped_with!r} is no other joint of its bus"
            )
        if each.swapped_with and (
            truth.holder(each.swapped_with) != name or truth.holder(name) != other.name
        ):
            raise InvalidInput(f"truth: {name}: swapped_with {other.name}, which is swapped with another one")
        _refuse_registers(specs[name], each)


def _refuse_registers(joint: JointSpec, each: JointTruth) -> None:
    if not each.eeprom():
        return
    registers = table(number_of(joint.type.device))
    for key, value in each.eeprom().items():
        if key not in registers or not registers[key].eeprom:
            raise InvalidInput(f"truth: {joint.name}: {registers.model} has no EEPROM register {key!r}")
        if not registers[key].takes(value):
            low, high = registers[key].bounds
            raise InvalidInput(f"truth: {joint.name}: {key} {value} is outside {low}..{high}")


def mechanical_stops(robot: RobotFile, truth: Truth) -> Mapping[str, tuple[float, float]]:
    """Return the ends of the joints, rad: by the truth, else as described, else the model's range."""
    found = dict(ranges_of(robot))
    for joint in robot.joints:
        free = (-math.inf, math.inf)  # a slot of a transmission ends where its joints do
        low, high = free if joint.transmission else found.get(joint.name, free)
        low = low if joint.stops.lower is None else joint.stops.lower
        high = high if joint.stops.upper is None else joint.stops.upper
        found[joint.name] = truth.joint_truth(joint.name).stops_rad or (low, high)
    return found


def random_truth(robot: RobotFile, seed: int) -> Truth:
    """Return the truth of a random robot: zeros anywhere on the encoder; own stops, friction, play, turns.

    Signs and ids are right. In position mode the travel keeps on one turn: it would be unusable otherwise.
    """
    random = np.random.default_rng(seed)
    return Truth({joint.name: _random(joint, random) for joint in robot.joints})


def _random(joint: JointSpec, random: np.random.Generator) -> JointTruth:
    below, above = random.uniform(*LOOSE, 2)
    stops = (joint.span[0] - float(below), joint.span[1] + float(above))
    turn = joint.type.ticks_per_turn
    start = turn_start(joint.type)
    low, high = sorted(ticks_of(joint, 0, stop) for stop in stops)
    one_turn = isinstance(joint.type, CanType) or joint.operating_mode == 3
    if one_turn and high - low < turn - 2 * CLEAR:
        zero = int(random.integers(start + CLEAR - low, start + turn - CLEAR - high))
    else:
        zero = int(random.integers(start, start + turn))
    friction = float(random.uniform(*RUBBING))
    ends = None if joint.transmission else stops  # its actuators end where their joints do
    if isinstance(joint.type, CanType):
        return JointTruth(zero_ticks=zero, stops_rad=ends, friction_nm=friction)
    play = float(random.uniform(0.0, PLAY))
    turns = int(random.integers(-WOUND, WOUND + 1))
    if joint.operating_mode == 3 and not isinstance(joint.type, CanType):
        turns = 0  # it wakes up on one turn
    return JointTruth(zero_ticks=zero, stops_rad=ends, friction_nm=friction, backlash_ticks=play, turns=turns)
