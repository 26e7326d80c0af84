"""measure where the joints are: sweep, zero, prove, and the file that says so

Torque stays off unless a step says otherwise. Sweep first, zero second: a zero that is set before the travel
is known may lie on the wrong turn.
"""

import argparse
from importlib import import_module

# name -> what it does; each is `twind_calibration/calibrating/NAME.py`
STEPS: dict[str, str] = {}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """One subcommand a step."""
    steps = parser.add_subparsers(dest="step", metavar="STEP", required=True)
    for name, what in STEPS.items():
        module = import_module(f"twind_calibration.calibrating.{name}")
        module.add_arguments(steps.add_parser(name, help=what, description=module.__doc__))


def run(options: argparse.Namespace) -> int:
    """Exit code of the step."""
    code: int = import_module(f"twind_calibration.calibrating.{options.step}").run(options)
    return code
