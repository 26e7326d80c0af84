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
from twind.learn.task.observation import BodyReading
from twind.learn.task.plant_model import Plant
from twind.learn.task.reward import RewardFunction
from twind.motion.setpoint_stream import SetpointStream
from twind.motion.stop_profiles import LimitedFollower, still
from twind.robot.arrays import Floats
from twind.robot.finding import Finding
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


class _FollowedBody:
    """A simulated body behind the gate and the follower of a loop."""

    def __init__(self, body: SimBody, plant: Plant) -> None:
        self.body = body
        self.limits = plant.binding.limits
        self.names = plant.layout.joints
        self.tick = plant.model.opt.timestep * plant.substeps  # s
        self._joints = np.arange(len(self.names))
        self._follower = LimitedFollower(still(plant.default), self.limits, self.tick)
        self._stream = SetpointStream(self._follower, np.ones(len(self.names), np.bool_))
        self._time = 0.0

    def go(self, pose: Floats, seconds: float) -> BodyReading:
        """Move to a pose and rest there."""
        self._stream.set_target(self._joints, pose, None)
        return self.advance(round(seconds / self.tick))

    def advance(self, ticks: int) -> BodyReading:
        """Follow the last setpoint for so many ticks."""
        for _ in range(ticks):
            self._stream.use(self._time)
            reference = self._follower.step()
            reading = self.body.advance(reference.position, reference.velocity)
            self._time += self.tick
        return reading

    def send(self, target: Floats, velocity: Floats, period: float) -> list[str]:
        """Send a setpoint as a drive does; return code and joint of each refusal."""
        sent = target - velocity * period
        valid = validity(period)
        verdict = judge(self._joints, sent, velocity, self.limits, valid_for=valid, allow_clamp=False).verdict
        if not verdict.refusals:
            self._stream.set_target(self._joints, sent, velocity, valid)
        return self._named(verdict.refusals)

    def late(self) -> list[str]:
        """Return code and joint of what is followed late."""
        return self._named(self._stream.behind()[1])

    def _named(self, findings: tuple[Finding, ...]) -> list[str]:
        return [f"{each.code} {self.names[each.joint or 0]}" for each in findings]


def roll_out(
    actor: PolicyActor,
    plant: Plant,
    body: SimBody,
    task: LearningTask,
    command: Floats,
    seconds: float,
    look: Callable[[SimBody], None] = lambda body: None,
) -> RolloutResult:
    """Drive `body`, whose period is the loop's, from its default pose. `look`: called after each period."""
    result = RolloutResult()
    judge_reward = RewardFunction(task, plant)
    reward = judge_reward.per_step(command, task.phases(actor.period))
    followed = _FollowedBody(body, plant)
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
    result.seconds = result.steps * actor.period
    base = plant.places.base_qpos
    result.forward = float(body.data.qpos[base] - start[base])
    result.clipped = getattr(actor.shaper, "clipped", 0)
    return result
