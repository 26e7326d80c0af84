"""Bench of a tuning on a daemon under a fake clock: virtual servos move a body in MuJoCo."""

from pathlib import Path

import numpy as np

from tests.support.body_rig import BodyRig, written_robot
from twind import link
from twind.robot.arrays import Floats
from twind.robot.trajectory import Trajectory
from twind.tuning.gain_search import Gains
from twind.tuning.step_response import StepResponse, measure_steps, step_motion

PLACE = {"shoulder_lift": -0.3, "elbow_flex": 0.3}
STEP = 0.15  # rad


class RigBench:
    """The built-in arm koch, stretched forward; `kind` is the type whose gains are tuned."""

    def __init__(self, folder: Path, gains: str, kind: str = "xl430") -> None:
        """`gains`: of the type, as in the file."""
        changed = ("gains: {p: 800, i: 0, d: 0}", f"gains: {gains}")
        self.rig = BodyRig(written_robot(folder, "koch", changed))
        self.rig.connect()
        self.file = self.gains_of(kind)
        self.kind = kind

    def gains_of(self, kind: str) -> Gains:
        """Gains in force."""
        types = {each.type.name: each.type for each in self.rig.loop.robot.bound.file.joints}
        gains = types[kind].gains
        return {"p": float(gains.p), "i": float(gains.i), "d": float(gains.d)}

    @property
    def limits(self) -> Gains:
        types = {each.type.name: each.type for each in self.rig.loop.robot.bound.file.joints}
        return types[self.kind].gain_limits

    def apply(self, gains: Gains) -> None:
        self._change(gains)
        self.rig.lease()
        assert self.rig.call(link.Arm).error is None
        self.rig.move_to(PLACE, 2.0)
        self.rig.seconds(0.5)

    def restore(self) -> None:
        self._change(self.file)

    def step(self, joint: str) -> StepResponse:
        rig = self.rig
        place = rig.names.index(joint)
        limits = rig.loop.robot.limits
        start = float(rig.loop.executor.reference.position[place])
        there = start + STEP
        positions, times = step_motion(
            start, there, float(limits.velocity[place]), float(limits.acceleration[place])
        )
        commanded = np.arange(len(rig.names)) == place
        rows = np.tile(rig.loop.executor.reference.position, (len(times), 1))
        rows[:, place] = positions
        rig.lease()
        ticket = rig.submit(Trajectory(times, rows, commanded, np.zeros_like(rows)), more=True)
        seen: list[tuple[float, float, float]] = []
        for _ in range(round((times[-1] + 0.3) / 0.01)):
            rig.ticks(1)
            goal = float(rig.loop.executor.reference.position[place])
            seen.append((rig.clock.now(), goal, float(rig.loop.robot.measured.position[place])))
        assert rig.replies(ticket)[-1].parameters["phase"] == "succeeded", rig.replies(ticket)
        columns: Floats = np.array(seen).T
        return measure_steps(*columns)

    def _change(self, gains: Gains) -> None:
        rig = self.rig
        rig.lease()
        assert rig.call(link.Disarm, ticks=3000).error is None
        reply = rig.adopt({f"types.{self.kind}.gains": dict(gains)})
        assert reply.error is None, reply
