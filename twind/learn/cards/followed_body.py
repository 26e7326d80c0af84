"""A simulated body behind the gate, the executor and the collision look-ahead of a loop.

The guard's rules on measured values (following errors, load, heat, buses, falls) are absent.
"""

from collections import Counter

import numpy as np

from twind.learn.environment.sim_body import SimBody
from twind.learn.task.observation import BodyReading
from twind.learn.task.plant_model import Plant
from twind.motion.trajectory_executor import TrajectoryExecutor
from twind.robot.arrays import Floats
from twind.robot.finding import Finding
from twind.robot_client.control_timing import validity
from twind.safety.clearance_rules import reaction_to
from twind.safety.guard_types import GuardThresholds, Reaction
from twind.safety.setpoint_gate import judge
from twind.twin.collision_lookahead import CollisionLookahead


class FollowedBody:
    """A `SimBody` that follows setpoints as a robot of the daemon does."""

    def __init__(self, body: SimBody, plant: Plant) -> None:
        """Raises InvalidInput for names in `collision:` of the robot file that the model lacks."""
        self.body = body
        self.limits = plant.binding.limits
        self.names = plant.layout.joints
        self.tick = plant.model.opt.timestep * plant.substeps  # s
        self.held = ""  # why the guard held it; "": it did not
        self.slowed: Counter[str] = Counter()  # ticks that a near collision slowed, by its pair
        self._joints = np.arange(len(self.names))
        self._executor = TrajectoryExecutor(self.limits, self.tick)
        self._executor.begin(plant.default)
        self._outlook = CollisionLookahead.of(plant.binding, self.tick)
        self._least_pace = GuardThresholds().least_pace
        self._time = 0.0

    def go(self, pose: Floats, seconds: float) -> BodyReading:
        """Move to a pose and rest there."""
        self._executor.setpoint(self._joints, pose, None, seconds)
        return self.advance(round(seconds / self.tick))

    def advance(self, ticks: int) -> BodyReading:
        """Follow the last setpoint for so many ticks."""
        for _ in range(ticks):
            reference = self._executor.goal(self._time)
            assert reference is not None  # it has begun
            self._look_ahead()
            reading = self.body.advance(reference.position, reference.velocity)
            self._time += self.tick
        return reading

    def send(self, target: Floats, velocity: Floats, period: float) -> list[str]:
        """Send a setpoint as a drive does; return code and joint, or pair of bodies, of each refusal."""
        sent = target - velocity * period
        valid = validity(period)
        verdict = judge(self._joints, sent, velocity, self.limits, valid_for=valid, allow_clamp=False).verdict
        refusals = verdict.refusals
        if not refusals and self._outlook is not None:
            refusals = self._outlook.refuses(self._executor, self._joints, sent, velocity)
        if not refusals:
            self._executor.setpoint(self._joints, sent, velocity, valid)
        return self._named(refusals)

    def late(self) -> list[str]:
        """Return code and joint of what is followed late."""
        stream = self._executor.stream
        return [] if stream is None else self._named(stream.behind()[1])

    def _look_ahead(self) -> None:
        """Slow or hold the motion before a collision, as the guard does."""
        outlook = None if self._outlook is None else self._outlook.look(self._executor)
        self._executor.pace = 1.0
        if outlook is None or outlook.clearance > outlook.warn:
            return
        found = reaction_to(outlook, self._least_pace)
        self._executor.pace = found.pace
        self.slowed["-".join(outlook.pair)] += 1
        if found.reaction >= Reaction.HOLD:
            self._executor.stop("aborted", (found.finding,))
            self.held = f"{found.finding.code}: {found.finding.value:.4f} {found.finding.message}"

    def _named(self, findings: tuple[Finding, ...]) -> list[str]:
        return [
            f"{each.code} {each.message if each.joint is None else self.names[each.joint]}"
            for each in findings
        ]
