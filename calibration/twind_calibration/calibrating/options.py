"""The option that says which calibration file a step writes. Standard library only."""

import argparse


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of every step that writes it."""
    parser.add_argument(
        "--calibration", metavar="FILE", help="the file to write (default: the one that the daemon reads)"
    )
