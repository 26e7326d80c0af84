"""measure where the joints are: sweep, zero, prove, and the file that says so

Torque stays off unless a step says otherwise. Sweep first, zero second: a zero that is set before the travel
is known may lie on the wrong turn.
"""

import argparse
from importlib import import_module
from types import ModuleType

from twind.command_line.common_options import add_common_options

# name -> what it does; each is `twind_calibration/calibrating/NAME.py`
STEPS: dict[str, str] = {
    "scan": "who is on the buses, and set as described",
    "sweep": "move joints by hand from end to end: their travel",
    "zero": "hold the robot in a known pose: where angle 0 is",
    "endstop": "drive one joint against its stop: a finer zero; powered",
    "prove": "small moves against gravity: do signs and places agree with the model",
    "import": "from servo registers or a LeRobot file, instead of sweep and zero",
    "show": "the calibration file, or an earlier one",
    "diff": "what differs between two of them",
    "rollback": "put an earlier one back",
    "limits": "set the servos' own position limits, the last fence",
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
