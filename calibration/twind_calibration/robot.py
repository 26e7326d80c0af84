"""Make a robot file: servo, new, finish.

`servo` gives servos ids and a rate; `new` writes the file from scans, files of other software and a model;
`finish` settles what no source states, joint by joint.
"""

import argparse

from twind_calibration.drafting.robot_steps import STEPS
from twind_calibration.verb_step import add_steps

group = "set up"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """One subcommand a step."""
    add_steps(parser, STEPS)


def run(options: argparse.Namespace) -> int:
    """Run the step; return its exit code."""
    return STEPS[options.step].run(options)
