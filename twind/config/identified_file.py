"""The identified model `twind-identified/1`: what was measured of one robot, laid over its model.

`twindctl identify` writes it beside the calibration, as `NAME.identified.yaml`. What it does not name is as
in the model.
"""

import os
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta

from twind.config.atomic_save import require_name, save_text
from twind.config.calibration_file import HISTORY, Stamp, render
from twind.config.config_reader import ConfigReader, ConfigStruct, Plain, Text, file_error
from twind.config.identified_spec import (
    BOUNDS,
    IdentifiedBody,
    IdentifiedJoint,
    IdentifiedModel,
    ParameterEstimate,
)
from twind.config.robot_spec import RobotFile
from twind.config.yaml_tree import parse, read_text

FORMAT = "twind-identified/1"
SUFFIX = ".identified"  # NAME.identified.yaml beside NAME.yaml
DECIMALS = 9
HEAD = ("robot", "created", "tool", "source", "seconds", "held_out")
SECTIONS = ("joints", "bodies")


class IdentifiedKeys(ConfigStruct):
    """Keys of an identified model."""

    format: Text
    robot: Text
    created: Stamp
    tool: Text
    source: Text
    seconds: Annotated[float, Meta(ge=0.0)]
    held_out: Annotated[float, Meta(ge=0.0, lt=1.0)]
    joints: ConfigReader
    bodies: ConfigReader


def identified_path(calibration: Path) -> Path:
    """Return the path of the identified model of the robot with this calibration file, there or not."""
    return calibration.with_name(f"{calibration.stem}{SUFFIX}.yaml")


def require_writable(calibration: Path) -> None:
    """Require that a model can be written beside `calibration`. Raises ConfigError."""
    path = identified_path(calibration)
    require_name(path.parent, path.stem)
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise file_error(str(path), "cannot be written: its folder is missing or permits no new file")


def load_identified(path: Path, robot: RobotFile) -> IdentifiedModel:
    """The identified model at `path`, of `robot`. Raises ConfigError."""
    return read_identified(read_text(path), str(path), robot)


def read_identified(text: str, file: str, robot: RobotFile) -> IdentifiedModel:
    """The identified model that `text` holds; `file` is what messages call it.

    Raises ConfigError: another format, robot or joint, a value that is no number of its range.
    """
    top = ConfigReader(file, parse(text, file))
    top.require_format(FORMAT)
    given = top.read(IdentifiedKeys)
    if given.robot != robot.name:
        why = f"identified on robot {given.robot!r}, not on {robot.name!r}"
        raise top.refuse("robot", f"{why}: name another model by --identified, or remove this one")
    given.joints.require_known(robot.names)
    return IdentifiedModel(
        robot=given.robot,
        created=given.created,
        tool=given.tool,
        source=given.source,
        seconds=given.seconds,
        held_out=given.held_out,
        joints={name: _joint(section) for name, section in given.joints.sections().items()},
        bodies={name: _body(section) for name, section in given.bodies.sections().items()},
    )


def _joint(section: ConfigReader) -> IdentifiedJoint:
    for key in section:
        if "_deg" in key:  # N·m/deg is no scaled N·m/rad
            raise section.refuse(key, "an identified model has radians only: write the key with `_rad`")
    joint = section.read(IdentifiedJoint)
    for key, estimate in joint.estimates().items():
        _require_possible(section.section(key), key, estimate)
    return joint


def _body(section: ConfigReader) -> IdentifiedBody:
    body = section.read(IdentifiedBody)
    if body.mass_kg is not None:
        _require_possible(section.section("mass_kg"), "mass_kg", body.mass_kg)
    return body


def _require_possible(section: ConfigReader, parameter: str, estimate: ParameterEstimate) -> None:
    """Refuse a value beyond the bounds of its parameter, and one that is neither measured nor its prior."""
    least, most = BOUNDS[parameter]
    value = estimate.value
    if not least <= value <= most:
        raise section.refuse("value", f"{value:g} is outside {least:g} to {most:g}: identify it again")
    if not estimate.determined and abs(value - estimate.prior) > 10.0**-DECIMALS:
        why = f"{value:g} is not the prior, {estimate.prior:g}, though the data do not determine it"
        raise section.refuse("value", f"{why}: write `determined: true` for a value of your own")


def dump_identified(model: IdentifiedModel) -> str:
    """The file's text in one fixed form. Raises ValueError for a number that is not finite."""
    head = {key: _plain(getattr(model, key)) for key in HEAD}
    sections = {key: {name: _entries(each) for name, each in getattr(model, key).items()} for key in SECTIONS}
    return render({"format": FORMAT, **head}, sections, DECIMALS)


def save_identified(model: IdentifiedModel, calibration: Path) -> Path:
    """Write the identified model beside `calibration`, the earlier one kept as numbered history.

    Raises ConfigError (a name that is no file name, a file that does not read back), OSError (disk full).
    """
    path = identified_path(calibration)
    return save_text(path.parent, path.stem, dump_identified(model), HISTORY)


def _entries(value: object) -> dict[str, Plain]:
    """Return the fields of a dataclass that are not None."""
    values = ((each.name, getattr(value, each.name)) for each in fields(value))  # type: ignore[arg-type]
    return {name: _plain(each) for name, each in values if each is not None}


def _plain(value: Any) -> Plain:
    if isinstance(value, tuple):
        return [_plain(each) for each in value]
    return _entries(value) if is_dataclass(value) else value
