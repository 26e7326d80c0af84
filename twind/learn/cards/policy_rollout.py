"""A short drive of a policy in simulation: gate, executor and look-ahead of a loop before MuJoCo.

What the wire and the machine add (latency, quantised counts, missed periods) is absent.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from math import acos, degrees

import numpy as np

from twind.exceptions import InvalidInput
from twind.learn.cards.followed_body import FollowedBody
from twind.learn.environment.sim_body import SimBody
from twind.learn.live.base_estimator import odometry
from twind.learn.policy.policy_actor import PolicyActor
from twind.learn.task.learning_tasks import LearningTask
from twind.learn.task.plant_model import Plant
from twind.learn.task.reward import RewardFunction
from twind.robot.arrays import Floats

LATE_SHARE = 0.25  # of the periods in which a joint is followed late: from here on it is reported


@dataclass(slots=True)
class RolloutResult:
    """Figures of a rollout."""

    steps: int = 0
    seconds: float = 0.0
    returned: float = 0.0  # sum of the rewards of the task
    ended: str = ""  # why before its time; "": it was not
    forward: float = 0.0  # m that the base moved, along x of the start
    tilt: float = 0.0  # degrees, at most
    refused: Counter[str] = field(default_factory=Counter)  # setpoints, by code and joint
    late: Counter[str] = field(default_factory=Counter)  # periods in which the loop followed late, likewise
    slowed: Counter[str] = field(default_factory=Counter)  # ticks that a near collision slowed, by its pair
    clipped: int = 0  # targets beyond the limits

    @property
    def limited(self) -> list[str]:
        """Joints, with the code, that the limits slow in more than `LATE_SHARE` of the periods."""
        return [name for name, count in self.late.items() if count > LATE_SHARE * self.steps]


def roll_out(
    actor: PolicyActor,
    plant: Plant,
    body: SimBody,
    task: LearningTask,
    command: Floats,
    seconds: float,
    look: Callable[[SimBody], None] = lambda body: None,
) -> RolloutResult:
    """Drive `body`, whose period is the loop's, from its default pose. `look`: called after each period.

    Raises InvalidInput for names in `collision:` of the robot file that the model lacks.
    """
    result = RolloutResult()
    judge_reward = RewardFunction(task, plant)
    reward = judge_reward.per_step(command, task.phases(actor.period))
    followed = FollowedBody(body, plant)
    body.reset(np.random.default_rng(0))
    start = body.data.qpos.copy()
    reading = followed.go(actor.shaper.default, 1.0)
    actor.begin()
    for step in range(round(seconds / actor.period)):
        reading.base_velocity[...] = odometry(reading)  # as on a robot
        result.tilt = max(result.tilt, degrees(acos(float(np.clip(-reading.gravity[2], -1.0, 1.0)))))
        if judge_reward.fallen(reading) or body.diverged:
            result.ended = "the simulation diverged" if body.diverged else "fallen"
            break
        try:
            action = actor.act(reading, command, step)
        except InvalidInput as error:
            action = str(error)
        if isinstance(action, str):
            result.ended = action
            break
        target, velocity = actor.shape(action)
        result.refused.update(followed.send(target, velocity, actor.period))
        reading = followed.advance(round(actor.period / followed.tick))
        result.late.update(followed.late())
        result.returned += reward(reading, target, step)
        result.steps += 1
        look(body)
        if followed.held:
            result.ended = f"held by {followed.held}"
            break
    result.slowed = followed.slowed
    result.seconds = result.steps * actor.period
    base = plant.places.base_qpos
    result.forward = float(body.data.qpos[base] - start[base])
    result.clipped = getattr(actor.shaper, "clipped", 0)
    return result
