"""Identified models as tables."""

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import msgspec

from twind.command_line.text_table import align_columns
from twind.command_line.verb import Rejected, UsageError, observer, show
from twind.config.config_reader import ConfigReader, Text
from twind.config.identified_file import load_identified
from twind.config.identified_spec import IdentifiedJoint, IdentifiedModel, ParameterEstimate
from twind.config.robot_file import load_robot
from twind.config.yaml_tree import ConfigError, parse, read_text
from twind.identification.servo_parameters import interval

HEADINGS = ("joint", "parameter", "value", "95 % from", "to", "prior", "")


def show_model(options: argparse.Namespace, paths: Sequence[Path]) -> None:
    """Print the model at a path, or without one the daemon's. Raises Rejected, UsageError."""
    if len(paths) > 1:
        raise UsageError("identify show takes at most one file")
    model = _load(paths[0], options) if paths else _of_daemon(options)
    show(options, msgspec.to_builtins(model), "\n".join(model_lines(model)))


def compare_models(options: argparse.Namespace, paths: Sequence[Path]) -> None:
    """Print where two models differ, in standard deviations of both. Raises Rejected, UsageError."""
    if len(paths) != 2:
        raise UsageError("identify diff needs two files")
    first, second = (_load(path, options) for path in paths)
    rows: list[tuple[str, ...]] = [("joint", "parameter", "first", "second", "change", "sd")]
    for name in dict.fromkeys([*first.joints, *second.joints]):
        pair = [model.joints.get(name, IdentifiedJoint()).estimates() for model in (first, second)]
        for key in dict.fromkeys([*pair[0], *pair[1]]):
            rows.append((name, key, *_change(pair[0].get(key), pair[1].get(key))))
    data = {"first": msgspec.to_builtins(first), "second": msgspec.to_builtins(second)}
    show(options, data, "\n".join(align_columns(rows, (0, 1))))


def model_lines(model: IdentifiedModel) -> list[str]:
    """Return the lines of a table of all estimates; those at their prior are marked."""
    rows: list[tuple[str, ...]] = [HEADINGS]
    for name, joint in model.joints.items():
        rows += _rows(name, joint.estimates().items())
    for name, body in model.bodies.items():
        if body.mass_kg is not None:
            rows += _rows(name, [("mass_kg", body.mass_kg)])
    lines = [f"{model.robot}, {model.created}: {model.seconds:.0f} s from {model.source}"]
    return lines + align_columns(rows, (0, 1, len(HEADINGS) - 1))


def _rows(name: str, estimates: Iterable[tuple[str, ParameterEstimate]]) -> list[tuple[str, ...]]:
    found = []
    for key, each in estimates:
        low, high = interval(key, each.value, each.sd)
        numbers = [f"{number:.4g}" for number in (each.value, low, high, each.prior)]
        found.append((name, key, *numbers, "" if each.determined else "not determined: prior"))
    return found


def _change(first: ParameterEstimate | None, second: ParameterEstimate | None) -> tuple[str, str, str, str]:
    if first is None or second is None:
        values = ["-" if each is None else f"{each.value:.4g}" for each in (first, second)]
        return values[0], values[1], "-", "-"
    change = second.value - first.value
    both = (first.sd**2 + second.sd**2) ** 0.5
    share = f"{change / first.value:+.1%}" if first.value > 0.0 else "-"
    return f"{first.value:.4g}", f"{second.value:.4g}", share, f"{change / both:+.1f}" if both > 0.0 else "-"


def _load(path: Path, options: argparse.Namespace) -> IdentifiedModel:
    """Return the model at `path`, of the robot of the options or the one that it names. Raises Rejected."""
    try:
        name = options.robot or _robot_of(path)
        return load_identified(path, load_robot(name))
    except ConfigError as error:
        raise Rejected(f"{path}: no identified model: {error}") from None


def _robot_of(path: Path) -> str:
    """Return the robot that a file of identified parameters names. Raises ConfigError."""
    name: str = ConfigReader(str(path), parse(read_text(path), str(path))).value("robot", Text)
    return name


def _of_daemon(options: argparse.Namespace) -> IdentifiedModel:
    with observer(options) as client:
        found: Any = client.call("GetRobot")["robot"].get("identified")
    if found is None:
        raise Rejected("the daemon's robot has no identified model: run `twindctl identify --live --write`")
    return msgspec.convert(found, IdentifiedModel)
