"""The drive of `policy check` on h24-standing."""

from collections.abc import Callable
from typing import Any

import numpy as np

from twind.config.robot_file import load_robot
from twind.learn.cards.driven_policy import actor_for, task_for
from twind.learn.cards.policy_rollout import RolloutResult, roll_out
from twind.learn.environment.sim_body import SimBody
from twind.learn.policy.policy_card import PolicyRobot
from twind.learn.randomise.randomisation_ranges import RandomisationRanges
from twind.learn.task.plant_model import plant_of

ROBOT = load_robot("h24-standing")


def simulated_drive(
    policy: Any, seconds: float, look: Callable[[SimBody], None] = lambda body: None
) -> RolloutResult:
    """The drive of `policy check`."""
    plant = plant_of(ROBOT, period=1.0 / ROBOT.rate_hz)
    described = PolicyRobot.from_limits("h24", plant.layout, plant.binding.limits, ROBOT.rate_hz)
    actor = actor_for(policy, described, plant.default)
    body = SimBody(plant, RandomisationRanges(), 1.0 / ROBOT.rate_hz)
    return roll_out(actor, plant, body, task_for(policy), np.zeros(3), seconds, look=look)
