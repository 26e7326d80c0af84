"""Calibrate the joints: sweep, zero, prove.

Torque stays off unless a step says otherwise. Sweep first, zero second: a zero that is set before the
travel is known may lie on the wrong turn.
"""

import argparse

from twind_calibration.calibrating.calibration_steps import STEPS
from twind_calibration.verb_step import add_steps

group = "set up"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """One subcommand a step."""
    add_steps(parser, STEPS)


def run(options: argparse.Namespace) -> int:
    """Run the step; return its exit code."""
    return STEPS[options.step].run(options)
