"""A policy of any origin as a drive needs it: its fit to a robot, its actor, its task and its commands."""

import argparse
from collections.abc import Mapping

import numpy as np

from twind.command_line.verb import UsageError
from twind.exceptions import InvalidInput
from twind.learn.cards.card_actor import CardActor, CardPolicy
from twind.learn.policy.policy_actor import PolicyActor, TrainedActor
from twind.learn.policy.policy_card import CLOSE, PolicyRobot, require_fit
from twind.learn.policy.policy_file import Policy
from twind.learn.task.learning_tasks import STAND, LearningTask, task_of
from twind.robot.arrays import Floats

AnyPolicy = Policy | CardPolicy
AXES = ("forward", "left", "turn")


def task_for(policy: AnyPolicy) -> LearningTask:
    """Return the task that judges a drive: of a carded policy `Stand`. Raises InvalidInput."""
    if isinstance(policy, CardPolicy):
        return STAND
    try:
        return task_of(policy.card.task)
    except KeyError as error:
        raise InvalidInput(str(error.args[0])) from None


def actor_for(policy: AnyPolicy, robot: PolicyRobot, default: Floats) -> PolicyActor:
    """Return the actor on a robot whose pose is `default` (n,), rad. Raises InvalidInput: it does not fit."""
    if isinstance(policy, Policy):
        require_fit(policy.card, robot)
        return TrainedActor(policy, task_for(policy))
    ticks = robot.rate_hz * policy.card.period
    if not (ticks >= 1.0 - CLOSE and abs(ticks - round(ticks)) <= CLOSE * ticks):
        possible = ", ".join(f"{robot.rate_hz / count:g}" for count in range(1, 5))
        raise InvalidInput(
            f"its card: rate_hz {policy.card.rate_hz:g} does not divide the loop's {robot.rate_hz:g}: "
            f"{possible} and so on do; change loop.rate_hz of the robot file, or train at such a rate"
        )
    return CardActor(policy, robot.joints, robot.limits, default)


def ranges_of(policy: AnyPolicy) -> Mapping[str, tuple[float, float]]:
    """Return the command range of each axis."""
    if isinstance(policy, CardPolicy):
        return policy.card.ranges
    spans = dict(zip(AXES, task_for(policy).command, strict=True))
    return {axis: policy.card.command.get(axis, span) for axis, span in spans.items()}


def command_for(options: argparse.Namespace, policy: AnyPolicy) -> Floats:
    """Return the command (3,) of a drive, within the trained ranges. Raises UsageError.

    Without `--command` it is the middle of each range.
    """
    spans = ranges_of(policy)
    given = options.command or [0.5 * sum(span) for span in spans.values()]
    for value, (axis, (low, high)) in zip(given, spans.items(), strict=True):
        if not low <= value <= high:
            raise UsageError(
                f"--command: {axis} {value:g} is outside what it was trained for: {low:g}..{high:g}"
            )
    return np.array(given, np.float64)
