"""The calibration file `twind-calibration/1`: what was measured of one specimen. State, hashed.

Raw counts are integers, so that a round trip is exact. The hash is of the file's text (UTF-8, LF) without its
`sha256:` line. `device_check.py` compares it with the servos, `atomic_save.py` writes it.
"""

import hashlib
import json
import math
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

from msgspec import Meta

from twind.config.atomic_save import save_text
from twind.config.calibrated_device import (
    DeviceRecord,
    Ticks,
    device_entries,
    make_device_record,
    read_device,
    require_sweep,
)
from twind.config.config_reader import ConfigReader, ConfigStruct, Plain, Text
from twind.config.counts import ticks_of, turn_start
from twind.config.robot_spec import JointSpec, RobotFile
from twind.config.yaml_tree import parse, read_text
from twind_drivers.bus import IdentifiedDevice

FORMAT = "twind-calibration/1"
HISTORY = 20  # earlier files kept beside the current one
SWEEP_MARGIN = 0.08  # rad, travel of a fitting calibration beyond the described limits

Method = Literal["jig", "endstop", "sweep", "gravity", "import"]
Stamp = Annotated[
    str,
    Meta(pattern=r"^\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ\Z", description="write a time as 2026-11-21T09:14:03Z"),
]


@dataclass(frozen=True, slots=True)
class JointCalibration:
    """One actuator. Counts are in the frame of Present Position as read with the recorded settings."""

    name: str
    bus: Text
    id: Annotated[int, Meta(ge=0, le=252)]
    device: DeviceRecord
    zero_ticks: Ticks  # count at angle 0
    zero_sigma_ticks: Annotated[float, Meta(ge=0.0)]
    captures: Annotated[int, Meta(ge=1, le=100_000)]
    sign: int
    sweep_ticks: tuple[int, int]  # travel seen, unwrapped
    seam_margin_ticks: int
    turn_band_ticks: tuple[int, int]  # half-open, one turn wide
    method: Method
    proof: Any = None  # a `Plain` value


@dataclass(frozen=True)
class Calibration:
    """One specimen. Joints in the order of the file; one that is missing is not calibrated."""

    robot: str
    robot_description_sha256: str
    created: str  # UTC, 2026-11-21T09:14:03Z
    tool: str
    method_default: str
    joints: tuple[JointCalibration, ...]
    sha256: str = ""  # of the text it was read from or dumped to

    @cached_property
    def by_name(self) -> Mapping[str, JointCalibration]:
        """Name of the actuator (the joint's, where it turns no other) -> its calibration."""
        return {joint.name: joint for joint in self.joints}


class DeviceEntry(ConfigStruct):
    """Key of a joint under which its device stands."""

    device: ConfigReader


class CalibrationKeys(ConfigStruct):
    """Keys of a calibration file."""

    format: Text
    sha256: Text
    robot: Text
    robot_description_sha256: Text
    created: Stamp
    tool: Text
    method_default: Method
    joints: ConfigReader


def turn_band(sweep: tuple[int, int], ticks_per_turn: int) -> tuple[int, int]:
    """One turn centred on the travel, half-open: exactly one of a count's turns lies in it."""
    first = (sweep[0] + sweep[1]) // 2 - ticks_per_turn // 2
    return first, first + ticks_per_turn


def seam_margin(sweep: tuple[int, int], ticks_per_turn: int, start: int = 0) -> int:
    """Smallest distance (counts) from the travel to a seam, 0 when it crosses one.

    Seams are whole turns away from `start`, the first count of a turn (`counts.turn_start`).
    """
    first = sweep[0] - start
    last = sweep[1] - start
    before = first % ticks_per_turn
    after = -last % ticks_per_turn
    crosses = first // ticks_per_turn != -(-last // ticks_per_turn) - 1
    return 0 if crosses else min(before, after)


# ------------------------------------------------------------------------------------------- reading


def load_calibration(path: Path, robot: RobotFile) -> Calibration:
    """The calibration at `path`, made for `robot`.

    Raises ConfigError: unreadable, wrong hash, another robot, another description, derived fields that do not
    follow from the travel, a sign that differs from the robot file's.
    """
    return read_calibration(read_text(path), str(path), robot)


def read_calibration(text: str, file: str, robot: RobotFile) -> Calibration:
    """The calibration that `text` holds; `file` is what messages call it. Raises ConfigError."""
    top = ConfigReader(file, parse(text, file))
    top.require_format(FORMAT)
    stated = top.value("sha256", Text)
    actual = text_hash(text)
    if stated != actual:
        remedy = "it was changed after it was written: calibrate again, or put the earlier file back"
        raise top.refuse("sha256", f"{stated} is not the hash of this file, {actual}; {remedy}")
    given = top.read(CalibrationKeys)
    if given.robot != robot.name:
        raise top.refuse("robot", f"made for robot {given.robot!r}, not for {robot.name!r}")
    if given.robot_description_sha256 != robot.description_sha256:
        message = f"{given.robot_description_sha256} is not that of {robot.path}, {robot.description_sha256}"
        remedy = "joints, ids, signs or ratios changed since: undo that, or calibrate again"
        raise top.refuse("robot_description_sha256", f"{message}; {remedy}")
    specs = {joint.actuator: joint for joint in robot.joints}
    given.joints.require_known(specs)
    return Calibration(
        robot=given.robot,
        robot_description_sha256=given.robot_description_sha256,
        created=given.created,
        tool=given.tool,
        method_default=given.method_default,
        joints=tuple(
            _joint(section, specs[name], given.method_default)
            for name, section in given.joints.sections().items()
        ),
        sha256=stated,
    )


def set_aside(path: Path) -> str:
    """Return the command that moves a file away, under a name that no other has."""
    name = shlex.quote(str(path))
    return f"`mv --backup=numbered {name} {name}.old`"


def text_hash(text: str) -> str:
    """sha256 of a calibration's text (UTF-8, LF) without its `sha256:` line."""
    lines = text.replace("\r\n", "\n").split("\n")
    kept = "\n".join(line for line in lines if not line.startswith("sha256:"))
    return hashlib.sha256(kept.encode()).hexdigest()


def _joint(section: ConfigReader, joint: JointSpec, usual: str) -> JointCalibration:
    """The calibration of an actuator by the method `usual`, where it says no other. Raises ConfigError."""
    turn = joint.type.ticks_per_turn
    method = {} if section.has("method") else {"method": usual}
    device = read_device(section.section("device"))
    found = section.read(JointCalibration, DeviceEntry, name=joint.actuator, device=device, **method)
    if found.bus != joint.bus:
        raise section.refuse("bus", f"{found.bus} is not the bus of the robot file, {joint.bus}")
    if found.id != joint.id:
        raise section.refuse("id", f"{found.id} is not the id of the robot file, {joint.id}")
    if found.sign != joint.sign:
        remedy = "neither wins: find out which is true, then correct the other"
        message = f"{found.sign} is not the sign of the robot file, {joint.sign}; {remedy}"
        raise section.refuse("sign", message)
    require_sweep(section, found.sweep_ticks)
    _derived(section, "turn_band_ticks", found.turn_band_ticks, turn_band(found.sweep_ticks, turn))
    margin = seam_margin(found.sweep_ticks, turn, turn_start(joint.type))
    _derived(section, "seam_margin_ticks", found.seam_margin_ticks, margin)
    return found


def _derived(section: ConfigReader, key: str, given: object, computed: object) -> None:
    if given != computed:
        raise section.refuse(key, f"{given} does not follow from sweep_ticks, which give {computed}")


# ------------------------------------------------------------------------------------------- writing


def fitting(
    robot: RobotFile,
    zeros: Mapping[str, int],
    devices: Mapping[tuple[str, int], IdentifiedDevice],
    *,
    created: str,
    tool: str,
) -> Calibration:
    """The calibration of servos whose truth is known: `zeros` in counts by joint, `devices` by (bus, id).

    The travel is the described limits and 0.08 rad more. Raises KeyError: a joint without zero or device.
    """
    joints = tuple(_fitted(joint, zeros[joint.name], devices[joint.bus, joint.id]) for joint in robot.joints)
    calibration = Calibration(robot.name, robot.description_sha256, created, tool, "import", joints)
    return replace(calibration, sha256=text_hash(dump_calibration(calibration)))


def _fitted(joint: JointSpec, zero: int, device: IdentifiedDevice) -> JointCalibration:
    ends = sorted(
        ticks_of(joint, zero, angle) for angle in (joint.span[0] - SWEEP_MARGIN, joint.span[1] + SWEEP_MARGIN)
    )
    sweep = (ends[0], ends[1])
    turn = joint.type.ticks_per_turn
    return JointCalibration(
        name=joint.actuator,
        bus=joint.bus,
        id=joint.id,
        device=make_device_record(device),
        zero_ticks=zero,
        zero_sigma_ticks=0.0,
        captures=1,
        sign=joint.sign,
        sweep_ticks=sweep,
        seam_margin_ticks=seam_margin(sweep, turn, turn_start(joint.type)),
        turn_band_ticks=turn_band(sweep, turn),
        method="import",
    )


def dump_calibration(calibration: Calibration) -> str:
    """The file's text in one fixed form, its hash last."""
    head = {
        "format": FORMAT,
        "robot": calibration.robot,
        "robot_description_sha256": calibration.robot_description_sha256,
        "created": calibration.created,
        "tool": calibration.tool,
        "method_default": calibration.method_default,
    }
    text = render(head, {"joints": {joint.name: _entries(joint) for joint in calibration.joints}})
    return f'{text}sha256: "{text_hash(text)}"\n'


def render(
    head: Mapping[str, Plain], sections: Mapping[str, Mapping[str, Mapping[str, Plain]]], decimals: int = 6
) -> str:
    """The text of a file in one fixed form: a line for each entry of what a section names, as joints."""
    lines = [f"{key}: {_flow(value, decimals)}" for key, value in head.items()]
    for section, named in sections.items():
        lines.append(f"{section}:" if named else f"{section}: {{}}")
        for name, entries in named.items():
            lines.append(f"  {_flow(name, decimals)}:" if entries else f"  {_flow(name, decimals)}: {{}}")
            lines += [f"    {key}: {_flow(value, decimals)}" for key, value in entries.items()]
    return "\n".join(lines) + "\n"


def save_calibration(calibration: Calibration, folder: Path, individual: str) -> Path:
    """Write `folder/individual.yaml`, the earlier one kept as numbered history: old or new, never mixed.

    Raises ConfigError (a name that is no file name, a file that does not read back), OSError (disk full).
    """
    return save_text(folder, individual, dump_calibration(calibration), HISTORY)


def _entries(joint: JointCalibration) -> dict[str, Plain]:
    entries: dict[str, Plain] = {
        "bus": joint.bus,
        "id": joint.id,
        "device": device_entries(joint.device),
        "zero_ticks": joint.zero_ticks,
        "zero_sigma_ticks": joint.zero_sigma_ticks,
        "captures": joint.captures,
        "sign": joint.sign,
        "sweep_ticks": list(joint.sweep_ticks),
        "seam_margin_ticks": joint.seam_margin_ticks,
        "turn_band_ticks": list(joint.turn_band_ticks),
        "method": joint.method,
    }
    return entries if joint.proof is None else entries | {"proof": joint.proof}


def _flow(value: Plain, decimals: int) -> str:
    """A value on one line that reads back as itself, to so many decimals. Raises ValueError: not finite."""
    if isinstance(value, dict):
        items = (f"{_flow(key, decimals)}: {_flow(item, decimals)}" for key, item in value.items())
        return "{" + ", ".join(items) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_flow(item, decimals) for item in value) + "]"
    if isinstance(value, float):
        if not math.isfinite(value):
            raise ValueError(f"{value} cannot stand in a file")
        return f"{value:.{decimals}f}"  # never 1e-05, which YAML reads as text
    astral = isinstance(value, str) and any(character > "\uffff" for character in value)
    return json.dumps(
        value, ensure_ascii=not astral
    )  # two escaped surrogates are one character in JSON alone
