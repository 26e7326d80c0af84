"""Make a robot file: servo, new, finish; look at it: show.

`servo` gives servos ids and a rate; `new` writes the file from scans, files of other software and a model;
`finish` settles what no source states, joint by joint.
"""

import argparse
from importlib.metadata import entry_points

from twind.command_line.verb import Verb
from twind_calibration.drafting.robot_steps import STEPS
from twind_calibration.verb_step import add_steps

group = "set up"

ENTRY_POINTS = "twind.robot_steps"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """One subcommand a step."""
    add_steps(parser, STEPS, _installed_steps())


def run(options: argparse.Namespace) -> int:
    """Run the step; return its exit code."""
    if options.step in STEPS:
        return STEPS[options.step].run(options)
    return _installed_steps()[options.step].run(options)


def _installed_steps() -> dict[str, Verb]:
    """Steps of other packages: this one may not import the viewer."""
    return {point.name: point.load() for point in entry_points(group=ENTRY_POINTS)}
