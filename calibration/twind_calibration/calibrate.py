"""Calibrate the joints: sweep, zero, prove.

Torque stays off unless a step says otherwise. Sweep first, zero second: a zero that is set before the
travel is known may lie on the wrong turn.
"""

import argparse
from importlib import import_module
from types import ModuleType

from twind.command_line.common_options import add_common_options

group = "set up"

# name -> what it does; each is `twind_calibration/calibrating/NAME.py`
STEPS: dict[str, str] = {
    "scan": "scan the buses and compare the devices with the files",
    "sweep": "measure the travel: move joints by hand from end to end",
    "zero": "measure where angle 0 is: hold the robot in a known pose",
    "endstop": "refine the zero: drive one joint against its stop, powered",
    "prove": "compare signs and zeros with the model by small moves against gravity",
    "import": "import from servo registers or a LeRobot file, instead of sweep and zero",
    "show": "show the calibration file, or an earlier one",
    "diff": "compare two calibration files",
    "rollback": "restore an earlier calibration file",
    "limits": "set the position limits in the servos",
}
# of the steps whose name is no name of a module, or that share one
MODULES: dict[str, str] = {
    "import": "import_verb",
    "scan": "calibrate_scan",
    "show": "history",
    "diff": "history",
    "rollback": "history",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """One subcommand a step."""
    steps = parser.add_subparsers(dest="step", metavar="STEP", required=True)
    for name, what in STEPS.items():
        module = _module(name)
        under = steps.add_parser(name, help=what, description=module.__doc__)
        under.set_defaults(step=name)  # for a room that several steps share
        add_common_options(under, argparse.SUPPRESS)  # also after the step
        module.add_arguments(under)


def run(options: argparse.Namespace) -> int:
    """Exit code of the step."""
    code: int = _module(options.step).run(options)
    return code


def _module(step: str) -> ModuleType:
    return import_module(f"twind_calibration.calibrating.{MODULES.get(step, step)}")
