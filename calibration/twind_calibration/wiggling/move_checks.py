"""Checks before a move and questions after it: options, arming, positions, observed motion."""

import argparse
import sys
from collections.abc import Sequence

import numpy as np

from twind.client import Client
from twind.command_line.verb import Rejected, UsageError, lease
from twind.ctl.command_hint import command_hint
from twind.robot.arrays import Floats

AROUND = 0.4  # s that are recorded before and after a move
MOST_FRICTION = 100.0  # N·m


def require_amounts(options: argparse.Namespace, least: float, most: float) -> None:
    """Check the bounds of the motion (degrees) and of the friction (N·m). Raises UsageError."""
    if not least <= options.degrees <= most:
        raise UsageError(f"--degrees {options.degrees:g} is outside {least:g} to {most:g}")
    if not 0.0 <= options.friction <= MOST_FRICTION:
        raise UsageError(f"--friction {options.friction:g} is outside 0 to {MOST_FRICTION:g} N·m")


def require_armed(options: argparse.Namespace, client: Client) -> None:
    """Armed, by --arm if need be. Raises Rejected, ClientError."""
    if client.call("GetStatus")["status"]["armed"]:
        return
    if not options.arm:
        raise Rejected("the robot is not armed: `twindctl arm`, or --arm, when no person is in its way")
    with lease(client, take=options.take):
        client.call("Arm")


def pose(client: Client, names: Sequence[str]) -> Floats:
    """Return the positions of the joints (rad, (n,)); NaN: no reading yet."""
    joints = client.call("GetStatus", joints=True)["joints"]
    by_name = {each["name"]: each["position"] for each in joints}
    return np.array([by_name[name] for name in names], np.float64)


def seen(options: argparse.Namespace, name: str, looks: str) -> bool | None:
    """Ask the operator for the observed motion; None: no question, or no clear answer."""
    if options.no_ask or options.json or not sys.stdin.isatty():
        return None
    question = f"{name}: {looks}, and back: was it so" if looks else f"did {name} move, and no other joint"
    print(f"{question}? [y/n, else unknown] ", end="", file=sys.stderr, flush=True)
    return {"y": True, "yes": True, "n": False, "no": False}.get(sys.stdin.readline().strip().lower())


def print_note(options: argparse.Namespace, line: str) -> None:
    """To the person, beside the result; its commands reach the same daemon."""
    print(command_hint(options).prose(line), file=sys.stderr, flush=True)
