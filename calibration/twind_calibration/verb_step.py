"""Step of a verb such as `twindctl calibrate sweep`: help, options, and the function that runs it.

The function is imported when the step runs: imports take up to a second, which the list need not pay.
"""

import argparse
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from types import MappingProxyType

from twind.command_line.common_options import add_common_options
from twind.command_line.verb import Verb, help_text

NONE: Mapping[str, Verb] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class VerbStep:
    """One step of a verb. `text`: its help, summary first. `place`: `MODULE:FUNCTION` that runs it."""

    text: str
    add_arguments: Callable[[argparse.ArgumentParser], None]
    place: str

    def run(self, options: argparse.Namespace) -> int:
        """Run the step; return its exit code, 0: everything that was asked for is done."""
        module, _, function = self.place.partition(":")
        code: int = getattr(import_module(f"twind_calibration.{module}"), function)(options)
        return code


def add_steps(
    parser: argparse.ArgumentParser, steps: Mapping[str, VerbStep], others: Mapping[str, Verb] = NONE
) -> None:
    """Add one subcommand a step, also for `others` of other packages; its name is the option `step`."""
    subparsers = parser.add_subparsers(dest="step", metavar="STEP", required=True)
    texts = {name: step.text for name, step in steps.items()}
    texts |= {name: help_text(verb) for name, verb in others.items()}
    every: dict[str, VerbStep | Verb] = {**steps, **others}
    for name, step in every.items():
        text = texts[name]
        under = subparsers.add_parser(
            name,
            help=text.partition("\n")[0],
            description=text,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        add_common_options(under, argparse.SUPPRESS)  # also after the step
        step.add_arguments(under)
