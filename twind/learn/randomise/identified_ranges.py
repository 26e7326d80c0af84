"""Spread of a robot's own parameters, from the uncertainties of its identified model.

A parameter that was not identified, or that the data did not determine, keeps the range of its profile. So
does one that is 0: a draw is a factor.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from twind.config.identified_file import load_identified
from twind.config.identified_spec import IdentifiedModel, ParameterEstimate
from twind.config.robot_file import load_robot
from twind.config.robot_spec import RobotFile
from twind.learn.randomise.measured_spread import Entry, MeasuredSpread, spread_within
from twind.learn.randomise.randomisation_ranges import (
    DEFAULT,
    RULES,
    RandomisationRanges,
    load_ranges,
)

# Quantity of a draw -> parameter of a joint. Damping with torque on is that of joint and servo together: both
# get the same factor.
JOINT_PARAMETERS: Mapping[str, str] = {
    "armature": "armature_kg_m2",
    "damping": "damping_nm_s_per_rad",
    "frictionloss": "friction_nm",
    "stiffness": "stiffness_nm_per_rad",
    "braking": "damping_nm_s_per_rad",
    "action_delay": "delay_s",
}


@dataclass(frozen=True, slots=True)
class RandomisedRobot:
    """A robot file, with its identified model if one is named, and the ranges of its randomisation."""

    robot: RobotFile
    ranges: RandomisationRanges


def randomised_robot(
    robot: str, randomise: str | Path | None, identified: str | Path | None
) -> RandomisedRobot:
    """Load a robot and its ranges. `identified`: file that the draws come from; None: the profile alone.

    Without a profile, what is not identified has the range of the profile `default`. Raises ConfigError.
    """
    loaded = load_robot(robot)
    if identified is None:
        return RandomisedRobot(loaded, load_ranges(randomise))
    model = load_identified(Path(identified), loaded)
    ranges = load_ranges(DEFAULT if randomise is None else randomise)
    return RandomisedRobot(replace(loaded, identified=model), with_measured(ranges, loaded, model))


def with_measured(
    ranges: RandomisationRanges, robot: RobotFile, model: IdentifiedModel
) -> RandomisationRanges:
    """Return `ranges` with the spreads of what was identified of `robot`."""
    measured: dict[str, dict[Entry, MeasuredSpread]] = {}
    for quantity, entry, spread in _spreads(robot, model):
        measured.setdefault(quantity, {})[entry] = spread
    return replace(ranges, measured=measured)


def _spreads(robot: RobotFile, model: IdentifiedModel) -> Iterator[tuple[str, Entry, MeasuredSpread]]:
    """Yield quantity, entry (joint or axis by number, body by name) and spread."""
    for quantity, parameter in JOINT_PARAMETERS.items():
        for name, estimate in model.estimates(parameter).items():
            if estimate.determined:
                yield from _entry(quantity, robot.names.index(name), estimate)
    for name, body in model.bodies.items():
        if body.mass_kg is not None and body.mass_kg.determined:
            yield from _entry("mass", name, body.mass_kg)
        if body.com_m is not None and name == robot.base:
            for axis, sd in enumerate(body.com_m.sd):
                yield "centre_of_mass", axis, _spread("centre_of_mass", 0.0, sd)


def _entry(
    quantity: str, entry: Entry, estimate: ParameterEstimate
) -> Iterator[tuple[str, Entry, MeasuredSpread]]:
    if quantity == "action_delay":
        yield quantity, entry, _spread(quantity, estimate.value, estimate.sd)
    elif estimate.value > 0.0:
        yield quantity, entry, _spread(quantity, 1.0, estimate.sd / estimate.value)


def _spread(quantity: str, centre: float, sd: float) -> MeasuredSpread:
    rule = RULES[quantity]
    return spread_within(centre, sd, rule.least, rule.most)
