"""A robot on its own feet with fall detection, pushed and watched in virtual time."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import cos, isfinite, nan, sin
from typing import Any

import mujoco
import numpy as np

from tests.support.walking_rig import WalkingRig
from twind.link import Event
from twind.robot.arrays import Floats
from twind.robot.fall_settings import FallReaction, FallSettings, FallState
from twind.robot.finding import ReasonCode
from twind.robot.modes import Mode
from twind.robot.trajectory import Trajectory
from twind.twin.mujoco_physics import MujocoPhysics
from twind.virtual.robot_ground_truth import RobotGroundTruth

CROUCH = {
    **{f"{side}_{joint}": angle for side in "lr" for joint, angle in (("hip_pitch", -1.6), ("knee", 2.1))},
    **{f"{side}_ankle_pitch": -0.5 for side in "lr"},
}
STILL = (0.0, 0.0, 0.0)
PERIOD = 0.01  # s
MOVED = 0.01  # rad of a goal


@dataclass(slots=True)
class Fall:
    """Outcome of a push. Times in s since its begin, NaN: it did not happen."""

    detected: float = nan
    reacted: float = nan  # goals changed or servos became soft
    ground: float = nan  # anything but a foot touches the floor
    speed: float = nan  # m/s of the base just before that
    torque: float = 0.0  # N·m, largest through a gear: of its motor and of its rotor's inertia
    force: float = 0.0  # N, largest of the floor on anything but the feet

    @property
    def fell(self) -> bool:
        return isfinite(self.ground)


class FallObserver:
    """In place of a body's support, which it passes everything on to: sees every step of 2 ms."""

    pushing = True  # else no step is reported

    def __init__(self, body: MujocoPhysics) -> None:
        self.fall = Fall()
        self._body = body
        self._support: Any = body.crane
        self._steps = 0
        self._speed = 0.0
        self._wrench = np.zeros(6)
        names = [body.model.body(int(place)).name for place in body.model.geom_bodyid]
        self._feet = np.array([name.endswith("foot") for name in names])
        self._floor = np.array([name == "world" for name in names])

    def __getattr__(self, name: str) -> Any:
        return getattr(self._support, name)

    def stepped(self) -> None:
        """Note a step."""
        if self._support.pushing:
            self._support.stepped()
        data = self._body.data
        self._steps += 1
        force = self._force_of_floor()
        fall = self.fall
        if force > 0.0 and not fall.fell:
            fall.ground = self._steps * self._body.model.opt.timestep
            fall.speed = self._speed
        self._speed = float(np.linalg.norm(data.qvel[:3]))
        fall.force = max(fall.force, force)
        through = data.qfrc_actuator - self._body.model.dof_armature * data.qacc
        fall.torque = max(fall.torque, float(np.abs(through[6:]).max()))

    def _force_of_floor(self) -> float:
        data = self._body.data
        total = 0.0
        for place in range(data.ncon):
            pair = data.contact.geom[place]
            if self._floor[pair].any() and not self._feet[pair].any():
                mujoco.mj_contactForce(self._body.model, data, place, self._wrench)
                total += float(np.linalg.norm(self._wrench[:3]))
        return total


class FallRig(WalkingRig):
    """h24-standing with a section `fall`; without a reaction falls are not detected."""

    def __init__(
        self,
        reaction: FallReaction | None = None,
        *,
        fold: Mapping[str, float] = CROUCH,
        truth: RobotGroundTruth | None = None,
        **settings: Any,
    ) -> None:
        self._settings = None if reaction is None else FallSettings(reaction, **settings)
        self._fold = fold
        super().__init__("h24-standing", Mode.LIVE, truth=truth)

    def _virtual(self, bus: str, start: Mapping[str, float]) -> Any:
        poses = {**self.robot.poses, "fold": {name: self._fold.get(name, 0.0) for name in self.robot.names}}
        self.robot = replace(self.robot, fall=self._settings, poses=poses)
        self.made = replace(self.made, robot=self.robot)
        return super()._virtual(bus, start)

    @property
    def state(self) -> FallState:
        return self.loop.parts.guard.falls.state

    @property
    def trips(self) -> list[Event]:
        """Events of falls so far."""
        return self.events(ReasonCode.FALLING)

    def follow(self, seconds: float, command: tuple[float, float, float] = STILL) -> bool:
        """Stand or walk by the engine while the daemon takes its goals; False: a fall was detected."""
        for _ in range(round(seconds / PERIOD)):
            self.walk(PERIOD, command)
            if self.trips:
                return False
        return True

    def squat(self, down: Mapping[str, float], seconds: float) -> bool:
        """Move both legs to `down`, rad by joint of a leg, and back; False: a fall was detected.

        The ways take `seconds` each, longer where the limits need it.
        """
        stance = self.engine.stance
        low = stance.copy()
        for joint, angle in down.items():
            for side in "lr":
                low[self.names.index(f"{side}_{joint}")] = angle
        rows = np.array([low, stance])
        rest = np.zeros_like(rows)
        way = Trajectory(np.array([1.0, 2.0]) * seconds, rows, np.ones(len(stance), np.bool_), rest)
        ticket = self.submit(way, more=True, policy="retime")
        while not any(not reply.continues for reply in self.replies(ticket)):
            self.ticks(1)
        return not self.trips

    def push(self, impulse: float, direction: float, seconds: float = 2.0) -> Fall:
        """Push the base by `impulse` N·s towards `direction`, rad from forward to the left; watch it.

        The engine stands on until the daemon refuses its goals.
        """
        assert self.body is not None
        begin = self.clock.now()
        observer: Any = FallObserver(self.body)
        observer.push(impulse * cos(direction), impulse * sin(direction))
        self.body.crane = observer
        fall: Fall = observer.fall
        kept = None
        for _ in range(round(seconds / PERIOD)):
            if self.loop.condition.latches or self.fallen:
                self.ticks(1)
            else:
                self.walk(PERIOD, STILL)
            if kept is None and self.trips:
                fall.detected = self.trips[0].time - begin
                kept = self.loop.robot.written
            elif kept is not None and not isfinite(fall.reacted) and self._reacts(kept):
                fall.reacted = self.clock.now() - begin
        return fall

    def _reacts(self, kept: Floats) -> bool:
        """Check that goals differ from those of the detection."""
        written = self.loop.robot.written
        return written is None or bool(np.abs(written - kept).max() > MOVED)
