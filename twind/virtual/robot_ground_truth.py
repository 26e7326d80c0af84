"""Ground truth of one virtual robot. No file of the robot contains it: a calibration has to find it.

`--truth FILE` maps `joints:` names to the keys of `JointGroundTruth`. Keys left out are as the
robot file describes them. In process the same data are these dataclasses.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta

from twind.config.calibrated_device import Byte, Tag, Ticks
from twind.config.config_reader import ConfigReader, ConfigStruct, Text
from twind.config.counts import ticks_of, turn_start
from twind.config.robot_spec import JointSpec, RobotFile
from twind.config.yaml_tree import parse, read_text
from twind.exceptions import InvalidInput
from twind.twin.mujoco_physics import ranges_of

LOOSE = (0.02, 0.08)  # rad, how far beyond the limits the stops of a random specimen are
# N·m; ticks; turns either way
RUBBING = (0.03, 0.1)
PLAY = 4.0
WOUND = 2
CLEAR = 8  # ticks from the seam that the travel of a random mode 3 joint keeps

NotNegative = Annotated[float, Meta(ge=0.0)]


@dataclass(frozen=True, slots=True)
class JointGroundTruth:
    """One joint and its actuator. Counts are the bare encoder's, before direction, turns and offset."""

    zero_ticks: Ticks | None = None  # at joint angle 0, anywhere; None: scattered, clear of the seam
    sign: Literal[1, -1] | None = None  # +1, -1: how the bare encoder counts; None: as in the robot file
    stops_rad: tuple[float, float] | None = (
        None  # mechanical ends of the joint; None: as described, else the model's
    )
    friction_nm: NotNegative | None = None  # dry; None: the model's. Joints without load have none
    backlash_ticks: NotNegative = 0.0  # play between encoder and joint, from one side to the other
    turns: Annotated[int, Meta(ge=-1000, le=1000)] = 0  # the count starts off by so many, until it is lost
    swapped_with: Text = ""  # a joint of the same bus whose servo has this one's id, and the other way round
    homing_offset: Ticks = 0  # register 20
    drive_mode: Byte | None = None  # register 10; None: the robot file's, else as delivered
    startup_configuration: Byte = 0  # register 60
    tag: Tag | None = None  # moving threshold (24): the stamp of a calibration
    registers: dict[str, Ticks] = field(default_factory=dict)  # of the EEPROM, over all others
    firmware: Byte | None = None
    forgets_offset: bool = False  # see `ServoSpec`
    seam_seed: Annotated[int, Meta(ge=0)] | None = None  # see `ServoSpec`

    def eeprom(self) -> dict[str, int]:
        """Return the registers that differ from a servo set by the robot file."""
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


PLAIN = JointGroundTruth()


class GroundTruthKeys(ConfigStruct):
    """Keys of a file of true values."""

    joints: ConfigReader


@dataclass(frozen=True)
class RobotGroundTruth:
    """True values of each joint, by name; a joint that is not in it is plain."""

    joints: Mapping[str, JointGroundTruth] = field(default_factory=dict)

    def joint_truth(self, name: str) -> JointGroundTruth:
        """Return the truth of one joint; the plain one if the file does not name it."""
        return self.joints.get(name, PLAIN)

    def holder(self, name: str) -> str:
        """The joint whose servo carries the id that belongs to `name`: itself, unless ids are exchanged."""
        other = self.joint_truth(name).swapped_with
        return other or next((one for one, each in self.joints.items() if each.swapped_with == name), name)


def load_truth(path: Path, robot: RobotFile) -> RobotGroundTruth:
    """The truth in a file, YAML or JSON. Raises ConfigError: unreadable, unknown key, no such joint."""
    section = ConfigReader(str(path), parse(read_text(path), str(path))).read(GroundTruthKeys).joints
    section.require_known(robot.names)
    return RobotGroundTruth(
        {name: _joint(section.section(name)) for name in robot.names if section.has(name)}
    )


def _joint(section: ConfigReader) -> JointGroundTruth:
    truth = section.read(JointGroundTruth)
    if truth.stops_rad is not None and not truth.stops_rad[0] < truth.stops_rad[1]:
        raise section.refuse("stops_rad", f"{truth.stops_rad[0]:g} is not below {truth.stops_rad[1]:g}")
    return truth


def refuse_impossible(robot: RobotFile, truth: RobotGroundTruth) -> None:
    """Raises InvalidInput: no such joint, or devices that cannot be exchanged."""
    specs = {joint.name: joint for joint in robot.joints}
    for name, each in truth.joints.items():
        if name not in specs:
            raise InvalidInput(f"truth: {robot.name} has no joint {name!r}; it has {', '.join(specs)}")
        other = specs.get(each.swapped_with or name)
        if other is None or other.bus != specs[name].bus or each.swapped_with == name:
            raise InvalidInput(
                f"truth: {name}: swapped_with {each.swapped_with!r} is no other joint of its bus"
            )
        if each.swapped_with and (
            truth.holder(each.swapped_with) != name or truth.holder(name) != other.name
        ):
            raise InvalidInput(f"truth: {name}: swapped_with {other.name}, which is swapped with another one")


def mechanical_stops(robot: RobotFile, truth: RobotGroundTruth) -> Mapping[str, tuple[float, float]]:
    """Return the ends of the joints, rad: by the truth, else as described, else the model's range."""
    found = dict(model_stops(robot))
    for joint in robot.joints:
        low, high = found[joint.name]
        low = low if joint.stops.lower is None else joint.stops.lower
        high = high if joint.stops.upper is None else joint.stops.upper
        found[joint.name] = truth.joint_truth(joint.name).stops_rad or (low, high)
    return found


def model_stops(robot: RobotFile) -> Mapping[str, tuple[float, float]]:
    """Return the ends of the joints in the model, rad, infinite where it has none."""
    found = ranges_of(robot)
    free = (-math.inf, math.inf)  # also of a slot of a transmission: it ends where its joints do
    return {joint.name: free if joint.transmission else found.get(joint.name, free) for joint in robot.joints}


def random_truth(robot: RobotFile, seed: int) -> RobotGroundTruth:
    """Return the truth of a random robot: zeros anywhere on the encoder; own stops, friction, play, turns.

    Signs and ids are right. In position mode the travel keeps on one turn: it would be unusable otherwise.
    """
    random = np.random.default_rng(seed)
    return RobotGroundTruth({joint.name: _random(joint, random) for joint in robot.joints})


def _random(joint: JointSpec, random: np.random.Generator) -> JointGroundTruth:
    below, above = random.uniform(*LOOSE, 2)
    stops = (joint.span[0] - float(below), joint.span[1] + float(above))
    turn = joint.type.ticks_per_turn
    start = turn_start(joint.type)
    low, high = sorted(ticks_of(joint, 0, stop) for stop in stops)
    one_turn = not joint.type.winds or joint.type.fenced(joint.mode)
    if one_turn and high - low < turn - 2 * CLEAR:
        zero = int(random.integers(start + CLEAR - low, start + turn - CLEAR - high))
    else:
        zero = int(random.integers(start, start + turn))
    friction = float(random.uniform(*RUBBING))
    ends = None if joint.transmission else stops  # its actuators end where their joints do
    if not joint.type.winds:
        return JointGroundTruth(zero_ticks=zero, stops_rad=ends, friction_nm=friction)
    play = float(random.uniform(0.0, PLAY))
    turns = int(random.integers(-WOUND, WOUND + 1))
    if one_turn:
        turns = 0  # it wakes up on one turn
    return JointGroundTruth(
        zero_ticks=zero, stops_rad=ends, friction_nm=friction, backlash_ticks=play, turns=turns
    )
