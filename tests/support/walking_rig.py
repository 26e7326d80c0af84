"""A freely standing robot on virtual servos with a body, walked through the gate in virtual time."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from tests.support.daemon_rig import Rig
from twind import link
from twind.link import Event
from twind.robot.arrays import Floats
from twind.twin.mujoco_physics import MujocoPhysics
from twind.virtual.virtual_robot_spec import body_for, buses
from twind.walk.balance import tilt_of
from twind.walk.walking_engine import WalkingEngine, WalkSettings

FALLEN = 0.7  # rad of tilt
CARRIED = 1.0  # s until the support of the base has let go of an armed robot


class WalkingRig(Rig):
    """The whole daemon and one body on its feet; a step of `walk` is a setpoint of all joints."""

    body: MujocoPhysics | None = None

    def _virtual(self, bus: str, start: Mapping[str, float]) -> Any:
        if self.body is None:
            self.body = body_for(self.made, now=self.clock.now())
            self._buses = buses(self.made, physics=False, body=self.body, now=self.clock.now())
        return self._buses[bus]

    def stand(self) -> WalkingEngine:
        """Arm and wait until the feet carry the robot; return its engine."""
        self.arm()
        self.seconds(CARRIED)
        self.lease()
        self.engine = WalkingEngine(self.robot, WalkSettings())
        self.refusals: list[Any] = []
        self.changes = 0
        return self.engine

    @property
    def base(self) -> Floats:
        """True pose of the base (7,): place, m, and orientation w x y z."""
        assert self.body is not None
        return np.array(self.body.data.qpos[:7])

    @property
    def fallen(self) -> bool:
        return max(map(abs, tilt_of(self.base[3:]))) > FALLEN

    def walk(self, seconds: float, command: tuple[float, float, float]) -> bool:
        """Walk for a time; False: it fell."""
        period = self.loop.robot.period
        joints = list(range(len(self.names)))
        before = self.loop.executor.reference.position.copy()
        for _ in range(round(seconds / period)):
            imu = self.loop.robot.measured.imu
            goals = self.engine.advance(
                period,
                np.array(command),
                None if imu is None else imu.quaternion,
                None if imu is None else imu.gyro,
            )
            ticket = self.send(
                link.Setpoint,
                joints=joints,
                positions=goals.tolist(),
                velocities=((goals - before) / period).tolist(),
                received=self.clock.now(),
            )
            before = goals
            self.ticks(1)
            self.refusals += [reply for reply in self.replies(ticket) if reply.error is not None]
            self.news = [news for news in self.news if isinstance(news, Event)]
            if self.fallen:
                return False
        return True
