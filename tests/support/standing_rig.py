"""A policy on the whole daemon under a fake clock: h24-standing in MuJoCo, real bytes, real loop and gate.

What `twindctl policy run` does over a socket is done over the loop's own link here: the same pilot, the same
estimate. A setpoint is sent once the news of a tick are out, so the next tick takes it, as on a real machine.
"""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tests.support.daemon_rig import Rig
from twind import link
from twind.config.robot_file import load_robot
from twind.learn.cards.driven_policy import actor_for, task_for
from twind.learn.live.base_estimator import BaseEstimator
from twind.learn.policy.policy_card import PolicyRobot
from twind.learn.policy.policy_controller import NoSetpoint, PolicyController, PolicyEnd, PolicySetpoint
from twind.learn.task.observation import BodyReading
from twind.learn.task.plant_model import plant_of
from twind.learn.task.reward import RewardFunction
from twind.link import Tick
from twind.robot.modes import Mode
from twind.robot_client.state_message import ImuReading, StateMessage
from twind.twin.mujoco_physics import MujocoPhysics
from twind.virtual.virtual_robot_spec import body_for, buses

VALID = 0.06  # s, as `live/setpoint_session.py`


class StandingRig(Rig):
    """h24-standing with a body; `drive` lets a policy stand it."""

    def __init__(self, robot: str = "h24-standing", mode: Mode = Mode.LIVE, **others: Any) -> None:
        """`others`: of `Rig`."""
        self._made_buses: dict[str, Any] = {}
        super().__init__(robot, mode, **others)
        self.pilot: PolicyController | None = None
        self.refused: Counter[str] = Counter()
        self.told: list[str] = []  # why it held or ended

    def _virtual(self, bus: str, start: Any) -> Any:
        if not self._made_buses:
            self.body: MujocoPhysics = body_for(self.made, now=self.clock.now())
            self._made_buses = buses(self.made, physics=False, body=self.body, now=self.clock.now())
        return self._made_buses[bus]

    def stand_up(self) -> None:
        """Armed, and let go of by whoever held it."""
        self.arm()
        self.seconds(2.0)
        self.lease()
        assert self.base_support.is_holding is False

    @property
    def base_support(self) -> Any:
        """Support that held it; it pushes, too."""
        return self.body.crane

    def state_message(self) -> StateMessage:
        """The newest state, as `Monitor` would have told it."""
        tick = next(news for news in reversed(self.news) if isinstance(news, Tick))
        return of_tick(tick, self.clock.now())

    def pilots(self, policy: Any, command: Sequence[float] = (0.0, 0.0, 0.0)) -> PolicyController:
        """The policy, at the reins of this robot. `command`: forward, left, m/s; turn, rad/s."""
        plant = plant_of(self.robot, period=self.loop.robot.period)
        task = task_for(policy)
        limits = plant.binding.limits
        described = PolicyRobot.from_limits(self.robot.name, plant.layout, limits, self.robot.rate_hz)
        actor = actor_for(policy, described, plant.default)
        self.estimator = BaseEstimator(plant)
        judge = RewardFunction(task, plant)
        self.pilot = PolicyController(
            actor,
            self.estimator,
            judge.fallen,
            np.array(command),
            self.clock.now,
            judge.per_step(np.array(command), task.phases(actor.period)),
        )
        return self.pilot

    def drive(self, seconds: float, each: Any = None) -> str | None:
        """Why it ended before that; None: it did not. `each`: called before each period with its number."""
        assert self.pilot is not None
        count = round(self.pilot.period / self.loop.robot.period)
        for step in range(round(seconds / (count * self.loop.robot.period))):
            if each is not None:
                each(step)
            self.news = self.news[-50:]  # half a minute has some thousands
            done = self.pilot.step(self.state_message(), self.clock.now())
            if isinstance(done, PolicyEnd):
                self.told.append(done.reason)
                return done.reason
            ticket = self._sent(done)
            self.ticks(count)
            self._answered(ticket)
        return None

    def _sent(self, done: PolicySetpoint | NoSetpoint) -> int:
        if isinstance(done, NoSetpoint):
            self.told.append(done.reason)
            return self.send(link.RenewLease)
        return self.send(
            link.Setpoint,
            joints=list(range(len(self.names))),
            positions=done.position.tolist(),
            velocities=done.velocity.tolist(),
            valid_for=VALID,
        )

    def _answered(self, ticket: int) -> None:
        assert self.pilot is not None
        for reply in self.replies(ticket):
            if reply.error is None:
                if self.pilot.holding is None or "sequence" in reply.parameters:
                    self.pilot.record_acceptance()
            else:
                self.refused.update(each["code"] for each in reply.parameters["findings"])
                self.pilot.hold("refused")

    def base(self) -> dict[str, Any]:
        """State of the base."""
        told: dict[str, Any] = self.base_support.truth()
        return told


def soft(folder: Path, gain: int) -> str:
    """The file of an h24-standing whose servos have this P gain (register 84); its own is 1600."""
    one = load_robot("h24-standing")
    text = one.path.read_text().replace("gains: {p: 1600,", f"gains: {{p: {gain},")
    assert f"p: {gain}" in text
    path = folder / f"soft-{gain}.yaml"
    path.write_text(text.replace("mjcf: h24.xml", f"mjcf: {one.mjcf_path}"))
    return str(path)


def of_tick(tick: Tick, now: float) -> StateMessage:
    """State of a tick, as a client receives it."""
    row = [np.frombuffer(each) for each in (tick.position, tick.velocity, tick.goal, tick.age)]
    imu = np.frombuffer(tick.imu)
    felt = ImuReading(imu[:3], imu[3:6], imu[6:], tick.imu_age) if len(imu) else None
    return StateMessage(tick.time, now, tick.sequence, row[0], row[1], row[2], row[3], felt)


def truth(rig: StandingRig) -> BodyReading:
    """Values that a simulation would read of the body as it stands."""
    base = rig.base()
    reading = BodyReading.empty(len(rig.names))
    reading.base_velocity[...] = rotation(base["quaternion"]).T @ np.array(base["velocity"])
    return reading


def rotation(quaternion: list[float]) -> np.ndarray:
    """The matrix (3, 3) of w x y z."""
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
