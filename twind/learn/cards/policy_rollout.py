"""A short drive of a policy in simulation: the loop's own gate and follower between its targets and MuJoCo.

What the wire and the machine add (latency, quantised counts, missed periods) is absent.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from math import acos, degrees

import numpy as np

from twind.exceptions import InvalidInput
from twind.learn.environment.sim_body import SimBody
from twind.learn.live.base_estimator import odometry
from twind.learn.policy.policy_actor import PolicyActor
from twind.learn.task.learning_tasks import LearningTask
from twind.learn.task.plant_model import Plant
from twind.learn.task.reward import RewardFunction
from twind.motion.setpoint_stream import SetpointStream
from twind.motion.stop_profiles import LimitedFollower, still
from twind.robot.arrays import Floats
from twind.robot_client.control_timing import validity
from twind.safety.setpoint_gate import judge

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
    seed: int = 0,
    look: Callable[[SimBody], None] = lambda body: None,
) -> RolloutResult:
    """Drive `body`, whose period is the loop's, from its default pose. `look`: called after each period."""
    result = RolloutResult()
    judge_reward = RewardFunction(task, plant)
    limits = plant.binding.limits
    tick = plant.model.opt.timestep * plant.substeps
    count = round(actor.period / tick)
    follower = LimitedFollower(still(plant.default), limits, tick)
    every = np.ones(len(plant.default), np.bool_)
    stream = SetpointStream(follower, every)
    phases = task.phases(actor.period)
    joints = np.arange(len(every))
    reading = body.reset(np.random.default_rng(seed))
    start = body.data.qpos.copy()
    # As the drive begins: at rest in the policy's pose.
    for _ in range(round(1.0 / tick)):
        stream.set_target(joints, actor.shaper.default, None, np.inf)
        reference = follower.step()
        reading = body.advance(reference.position, reference.velocity)
    actor.begin()
    for step in range(round(seconds / actor.period)):
        reading.base_velocity[...] = odometry(reading)
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
        sent = target - velocity * actor.period
        valid = validity(actor.period)
        verdict = judge(joints, sent, velocity, limits, valid_for=valid, allow_clamp=False).verdict
        result.refused.update(
            f"{each.code} {plant.layout.joints[each.joint or 0]}" for each in verdict.refusals
        )
        if not verdict.refusals:
            stream.set_target(joints, sent, velocity)
        for at in range(count):
            stream.use(step * actor.period + at * tick)
            reference = follower.step()
            reading = body.advance(reference.position, reference.velocity)
        _, late = stream.behind()
        result.late.update(f"{each.code} {plant.layout.joints[each.joint or 0]}" for each in late)
        asked = command * task.share(step, actor.period)
        result.returned += float(judge_reward.reward(reading, target, asked, phases[step % len(phases)])[0])
        result.steps += 1
        look(body)
    result.seconds = result.steps * actor.period
    base = plant.places.base_qpos
    result.forward = float(body.data.qpos[base] - start[base])
    result.clipped = getattr(actor.shaper, "clipped", 0)
    return result
