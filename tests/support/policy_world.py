"""A robot, a policy and a clock around a policy controller."""

from dataclasses import replace

import numpy as np

from tests.support.policy_files import TWO
from twind.learn.policy.policy_actor import TrainedActor
from twind.learn.policy.policy_card import entries
from twind.learn.policy.policy_controller import NoSetpoint, PolicyController, PolicyEnd, PolicySetpoint
from twind.learn.task.learning_tasks import STAND
from twind.learn.task.observation import BodyReading
from twind.learn.task.observation_layout import ObservationLayout
from twind.robot_client.state_message import ImuReading, StateMessage

CARD = replace(TWO, layout=entries(ObservationLayout(TWO.joints)))
POSE = np.array(CARD.default)
PERIOD = 0.02


class World:
    """A robot that goes where the loop tells it, a policy that says `action`, and a clock."""

    def __init__(self) -> None:
        # takes: s that the policy takes to act
        self.card = CARD
        self.now = 100.0
        self.takes = 0.0
        self.action = np.zeros(2, np.float32)
        self.seen = np.zeros(0, np.float32)
        self.goal = POSE.copy()
        self.lies = False
        self.gyro = 0.0
        self.controller = PolicyController(
            TrainedActor(self, replace(STAND, stride=4.0 * PERIOD)),
            self,
            lambda reading: self.lies,
            np.zeros(3),
            lambda: self.now,
        )
        self.sent: list[PolicySetpoint] = []
        self.target = POSE.copy()
        self.drift = np.zeros(2)

    def act(self, observation: np.ndarray) -> np.ndarray:
        self.seen = observation
        self.now = self.now + self.takes
        return self.action.copy()

    def reading(self, message: StateMessage) -> BodyReading:
        reading = BodyReading.empty(2)
        reading.position[...] = message.position
        reading.gravity[...] = (0.0, 0.0, -1.0)
        reading.gyro[0] = self.gyro
        return reading

    def state_message(self, old: float = 0.0) -> StateMessage:
        row = np.zeros(2)
        imu = ImuReading(np.zeros(3), np.zeros(3), np.array([1.0, 0, 0, 0]), 0.0)
        time = self.now - old
        tick = 0 if time != time else round(time / 0.01)
        return StateMessage(time, self.now, tick, self.goal, row, self.goal.copy(), row, imu)

    def step(self, old: float = 0.0, *, refused: bool = False) -> PolicySetpoint | NoSetpoint | PolicyEnd:
        """One period: the loop follows what was sent, or brakes to rest at once."""
        done = self.controller.step(self.state_message(old), self.now)
        if isinstance(done, PolicySetpoint) and refused:
            done = self.controller.hold("refused")
        elif isinstance(done, PolicySetpoint):
            self.controller.record_acceptance()
            self.sent.append(done)
            self.goal = done.position + done.velocity * PERIOD
        self.now = 100.0 + PERIOD * (1 + round((self.now - 100.0) / PERIOD))
        return done
