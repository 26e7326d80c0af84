"""Show, check or run a policy, on the robot or the simulation.

A policy drives as any client does: with the lease, through the gate, at the rate of its training. Stale,
late or non-finite values make it hold; if they last, it ends. However it ends, the robot holds.
"""

import argparse
import json
from importlib.util import find_spec
from math import isfinite
from pathlib import Path

from twind.command_line.common_options import add_common_options
from twind.command_line.extras import how_to_add
from twind.command_line.verb import DONE, Rejected, UsageError, show
from twind.exceptions import InvalidInput

group = "learn"
TEMPLATES = ("isaaclab", "mjlab", "open-duck", "playground", "toddlerbot")  # frameworks


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `twindctl policy`."""
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="WHAT")
    shown = kinds.add_parser("show", help="show what the policy was made for")
    checks = kinds.add_parser("check", help="try the policy in simulation, before a robot")
    drives = kinds.add_parser("run", help="drive the robot, until Ctrl-C or --seconds")
    card = kinds.add_parser("card", help="print a card to fill in, for a policy of another framework")
    for each in (shown, checks, drives, card):
        add_common_options(each, argparse.SUPPRESS)  # also behind what is to be done
    for each in (shown, checks, drives):
        each.add_argument("file", metavar="FILE", type=Path, help="a policy file (.onnx)")
        each.add_argument(
            "--card", type=Path, metavar="YAML", help="its card; default: NAME.card.yaml beside"
        )
    for each in (checks, drives):
        each.add_argument(
            "--command",
            metavar="VX,VY,TURN",
            type=command,
            help="m/s forward, m/s to the left, rad/s; default: the middle of what it was trained for",
        )
    checks.add_argument("--seconds", type=float, metavar="S", default=5.0, help="of simulation (5)")
    drives.add_argument("--seconds", type=float, metavar="S", help="stop by itself")
    drives.add_argument("--take", action="store_true", help="take the lease from its present holder")
    card.add_argument("--template", choices=TEMPLATES, required=True, help="framework of the training")
    for each in (checks, card):
        each.add_argument("--robot", metavar="FILE|NAME", help="robot file, or the name of a built-in robot")


def command(text: str) -> tuple[float, float, float]:
    """`0.2,0,0` as numbers. Raises ArgumentTypeError."""
    try:
        forward, left, turn = (float(each) for each in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}: three numbers are needed, as in 0.2,0,0") from None
    if not all(map(isfinite, (forward, left, turn))):
        raise argparse.ArgumentTypeError(f"{text!r}: finite numbers are needed")
    return forward, left, turn


def run(options: argparse.Namespace) -> int:
    """The exit code. Raises UsageError, Rejected, ClientError."""
    if options.kind == "card":
        from twind.learn.cards.card_commands import write_template

        return write_template(options)
    if find_spec("onnxruntime") is None:
        raise UsageError(f"policy needs onnxruntime: {how_to_add('policy')}")
    from twind.config.yaml_tree import ConfigError
    from twind.learn.cards.card_actor import CardPolicy
    from twind.learn.cards.card_commands import run_check, show_card
    from twind.learn.cards.card_file import load_any

    try:
        policy = load_any(options.file, options.card)
    except (InvalidInput, ConfigError) as error:
        raise Rejected(str(error)) from None
    if options.kind == "run":
        from twind.learn.policy.policy_run_command import run_policy

        return run_policy(options, policy)
    if options.kind == "check":
        return run_check(options, policy)
    if isinstance(policy, CardPolicy):
        return show_card(options, policy)
    lines = [str(options.file), *_lines(json.loads(policy.card.text()))]
    show(options, json.loads(policy.card.text()), "\n".join(lines))
    return DONE


def _lines(card: dict[str, object]) -> list[str]:
    """A card for people: long rows of equal figures shortened."""
    lines = []
    for key, value in card.items():
        if isinstance(value, dict):
            text = ", ".join(f"{name} {_format_value(each, '..')}" for name, each in value.items()) or "-"
        else:
            text = _format_value(value)
        lines.append(f"{key:<14} {text}")
    return lines


def _format_value(value: object, between: str = " ") -> str:
    if isinstance(value, list):
        if len(value) > 2 and all(each == value[0] for each in value):
            return f"{_format_value(value[0])} each"
        return between.join(_format_value(each) for each in value)
    return f"{value:g}" if isinstance(value, float) else str(value)
