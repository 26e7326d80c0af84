"""`twindctl policy check` and `twindctl policy card`: the code between a terminal and cards."""

import argparse
import json
import sys

from threadpoolctl import threadpool_limits

from twind.command_line.verb import DONE, REFUSED, Rejected, UsageError, harmless, show
from twind.config.robot_file import RobotFile, load_robot
from twind.config.yaml_tree import ConfigError
from twind.exceptions import InvalidInput, OperationFailed
from twind.learn.cards.card_actor import CardPolicy
from twind.learn.cards.driven_policy import AnyPolicy, command_for
from twind.learn.cards.policy_check import CheckSettings, check_policy
from twind.learn.policy.onnx_session import limit_memory

ROBOT = "h24-standing"


def run_check(options: argparse.Namespace, policy: AnyPolicy) -> int:
    """Print one line per result; 1 where one fails. Raises UsageError, Rejected."""
    if not 0.0 < options.seconds <= 600.0:
        raise UsageError(f"--seconds {options.seconds:g}: above 0 and at most 600")
    robot = _robot(options, policy)
    threadpool_limits(limits=1)  # as in a run
    if options.mp4 is None:  # drawing in software takes more
        limit_memory()
    folder = (options.card or options.file).parent
    try:
        settings = CheckSettings(command_for(options, policy), options.seconds, folder, robot, options.mp4)
        failed = False
        with policy.ending_long_inferences():
            for line in check_policy(policy, settings):
                failed |= line.verdict == "fail"
                text = f"{line.verdict:<5} {line.name:<17} {harmless(line.text)}"
                print(json.dumps(line._asdict()) if options.json else text, flush=True)
    except (InvalidInput, OperationFailed) as error:
        raise Rejected(str(error)) from None
    return REFUSED if failed else DONE


def show_card(options: argparse.Namespace, policy: CardPolicy) -> int:
    """Print what the network receives and returns."""
    card = policy.card
    inputs = {name: list(shape) for name, shape in policy.shapes.items()}
    state = {name: list(each.shape) for name, each in card.state.items()}
    facts: dict[str, object] = {
        "name": card.name,
        "robot": card.robot,
        "rate_hz": card.rate_hz,
        "joints": card.joints,
    }
    facts |= {"inputs": inputs, "output": card.action.output, "state": state, "command": dict(card.ranges)}
    lines = [str(options.file)]
    for name, given in card.inputs.items():
        lines.append(f"input   {name} {inputs[name]}: {', '.join(given.terms)}; {given.history} steps")
    lines += [f"state   {name} {shape}" for name, shape in state.items()]
    lines.append(f"output  {card.action.output}: {', '.join(card.joints)}")
    lines.append(f"rate    {card.rate_hz:g} per second")
    show(options, facts, "\n".join(lines))
    return DONE


def write_template(options: argparse.Namespace) -> int:
    """Write a card to fill in for a robot, over no file. Raises Rejected."""
    from twind.learn.cards.card_templates import template_text

    try:
        text = template_text(options.template, load_robot(options.robot or ROBOT))
        if options.out is None:
            sys.stdout.write(text)
        else:
            with open(options.out, "x", encoding="utf-8") as file:
                file.write(text)
    except (ConfigError, InvalidInput, OSError) as error:
        raise Rejected(str(error)) from None
    return DONE


def _robot(options: argparse.Namespace, policy: AnyPolicy) -> RobotFile:
    """Return the robot of `--robot`, else that of the card. Raises Rejected."""
    name = options.robot or policy.card.robot or ROBOT
    try:
        return load_robot(name)
    except ConfigError as error:
        raise Rejected(f"{error}; name the robot by --robot") from None
