"""Calibrate the joints: sweep, zero, prove.

Torque stays off unless a step says otherwise. Sweep first, zero second: a zero that is set before the
travel is known may lie on the wrong turn.
"""

import argparse

from twind.command_line.common_options import add_common_options
from twind_calibration.calibrating.calibration_steps import STEPS

group = "set up"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """One subcommand a step."""
    steps = parser.add_subparsers(dest="step", metavar="STEP", required=True)
    for name, step in STEPS.items():
        under = steps.add_parser(name, help=step.summary, description=step.text)
        add_common_options(under, argparse.SUPPRESS)  # also after the step
        step.add_arguments(under)


def run(options: argparse.Namespace) -> int:
    """Run the step; return its exit code."""
    return STEPS[options.step].run(options)
