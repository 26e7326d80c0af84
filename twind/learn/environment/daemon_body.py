"""The body that is a running twind: setpoints through the gate, readings of joints and IMU, in real time."""

import numpy as np

from twind.client import Client, Refused
from twind.exceptions import OperationFailed
from twind.learn.live.base_estimator import BaseEstimator
from twind.learn.live.daemon_robot import require_mode
from twind.learn.live.setpoint_session import SetpointSession
from twind.learn.task.action_shaping import ActionShaping
from twind.learn.task.observation import BodyReading
from twind.learn.task.plant_model import Plant
from twind.robot.arrays import Floats
from twind.robot_client.control_timing import RateTimer, in_step
from twind.robot_client.daemon_robot_file import require_same
from twind.robot_client.require_armed import require_armed
from twind.robot_client.state_message import STALE
from twind.robot_client.state_subscriber import StateSubscriber
from twind_drivers.clock import MonotonicClock


class DaemonBody:
    """A `RobotBody`: targets reach the robot if the gate accepts them."""

    def __init__(self, plant: Plant, shaping: ActionShaping, socket: str | None) -> None:
        """`socket`: the daemon's folder, None: the usual one. Raises InvalidInput, ClientError."""
        self.plant = plant
        self._period = shaping.period
        self._clock = MonotonicClock()
        self._estimate = BaseEstimator(plant)
        self._joints = plant.layout.joints
        self.model = plant.model
        self.data = self._estimate.data
        with Client(socket) as client:
            status = client.call("GetStatus")["status"]
            description = client.call("GetRobot")
        require_same(description, plant.binding.robot)
        require_mode(status["mode"])
        require_armed(status)
        rate_hz = float(status["loop"]["rate_hz"])
        self._loop = 1.0 / rate_hz
        self.refused = 0  # setpoints, since the episode began
        self.missed = 0  # periods, since the episode began
        self.held = 0  # times that so many were missed that the gate held
        self._timer: RateTimer | None = None
        self._session = SetpointSession(Client(socket), self._joints, self._period)
        try:
            self._subscriber = StateSubscriber(Client(socket), self._joints, rate_hz)
        except Exception:
            self._session.drop()
            raise

    @property
    def diverged(self) -> bool:
        """A robot does not."""
        return False

    @property
    def step_info(self) -> dict[str, int]:
        """Counts of the episode: setpoints refused, periods missed, and holds after too many missed ones."""
        return {"refused": self.refused, "missed": self.missed, "held": self.held}

    def reset(self, rng: np.random.Generator) -> BodyReading:
        """Go to the default pose, through the gate: nothing is drawn, and who has fallen stays where it lies.

        Raises OperationFailed, ClientError.
        """
        self._session.take()
        self._session.go(self.plant.default)
        states = self._subscriber.next_states()
        if not states:
            raise OperationFailed(self._subscriber.ended or "no states are received")
        self._timer = in_step(states, self._clock.now(), self._period, self._loop)
        self.refused = self.missed = self.held = 0
        return self._read(self._timer)

    def advance(self, target: Floats, velocity: Floats) -> BodyReading:
        """Send, and wait for the end of the period. A refusal is counted in the next, and moves nothing.

        Raises OperationFailed, ClientError.
        """
        assert self._timer is not None, "reset first"
        try:
            self._session.send(target - velocity * self._period, velocity)
        except Refused:
            self.refused += 1
            self._session.keep()
        missed = self._timer.advance(self._clock.now())
        self.missed += missed
        self.held += self._session.lapses(missed)
        return self._read(self._timer)

    def close(self) -> None:
        """Stop, give the lease back, hang up: the robot holds."""
        self._session.drop()
        self._subscriber.close()

    def _read(self, timer: RateTimer) -> BodyReading:
        """At the deadline."""
        self._clock.sleep_until(timer.deadline)
        state = self._subscriber.newest
        why = self._subscriber.ended or (
            "no state has come" if state is None else state.stale(self._clock.now(), STALE, self._joints)
        )
        if state is None or why:
            raise OperationFailed(str(why))
        return self._estimate.reading(state)
