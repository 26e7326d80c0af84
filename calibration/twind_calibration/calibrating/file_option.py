"""Command-line option for the calibration file that a step writes. Standard library only."""

import argparse
import shlex


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add `--calibration FILE`, the option of every step that writes the calibration file."""
    parser.add_argument(
        "--calibration", metavar="FILE", help="the file to write (default: the one that the daemon reads)"
    )


def format_option(options: argparse.Namespace) -> str:
    """Return the same option as text for the next command; empty where it was not given."""
    return f" --calibration {shlex.quote(options.calibration)}" if options.calibration else ""
