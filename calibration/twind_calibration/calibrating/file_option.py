"""The option that says which calibration file a step writes. Standard library only."""

import argparse
import shlex


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of every step that writes it."""
    parser.add_argument(
        "--calibration", metavar="FILE", help="the file to write (default: the one that the daemon reads)"
    )


def named(options: argparse.Namespace) -> str:
    """The same option for the next command; empty where it was not given."""
    return f" --calibration {shlex.quote(options.calibration)}" if options.calibration else ""
