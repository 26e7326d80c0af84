"""Controller that runs a policy: fresh readings in, setpoints out; where either is missing it holds.

Time is passed in. A hold sends no setpoint at all: the gate then brakes and holds by itself. It ends when all
is fresh again and the robot rests within the policy's reach, or with the drive.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import acos, degrees, inf, nan
from typing import Protocol

import numpy as np

from twind.exceptions import InvalidInput
from twind.learn.policy.policy_actor import PolicyActor
from twind.learn.task.observation import BodyReading
from twind.robot.arrays import Floats
from twind.robot_client.state_message import STALE, StateMessage

LATE = 0.5  # of a period after its deadline an action is too late
PATIENCE = 1.0  # s of a hold after which the drive ends
STRAY = 0.05  # rad beyond its targets at which a robot is out of a policy's reach
RESTING = 1e-4  # rad a goal may move between two states of a robot that rests
APART = 0.5  # of a period that these states are apart, at least


class ReadingConverter(Protocol):
    """Converter of states to readings."""

    def reading(self, state: StateMessage) -> BodyReading:
        """Return the reading of a fresh state."""


@dataclass(frozen=True, slots=True)
class PolicySetpoint:
    """Setpoint to send now. Arrays (n,)."""

    position: Floats  # rad, now
    velocity: Floats  # rad/s, until the next


@dataclass(frozen=True, slots=True)
class NoSetpoint:
    """Result of a step that sends nothing, with its reason."""

    reason: str


@dataclass(frozen=True, slots=True)
class PolicyEnd:
    """Result of a step that ends the drive, with its reason."""

    reason: str


@dataclass(slots=True)
class PolicyStatistics:
    """Figures of a controller, for reports."""

    steps: int = 0  # actions that became setpoints, and were taken
    holds: int = 0
    too_late: int = 0  # actions that came so late that they were a hold
    held: float = 0.0  # s, of all holds together
    tilt: float = nan  # degrees from upright, now
    most_tilt: float = 0.0
    inference: float = nan  # s, of the last action, its observation included
    returned: float = 0.0  # sum of the rewards of `judged` steps, by the estimated readings
    judged: int = 0
    source: float = nan  # s, monotonic: the tick whose state it acted on


class PolicyController:
    """One drive of one policy, from rest in its default pose on."""

    def __init__(
        self,
        actor: PolicyActor,
        seeing: ReadingConverter,
        fallen: Callable[[BodyReading], bool],
        command: Floats,
        clock: Callable[[], float],
        reward: Callable[[BodyReading, Floats, int], float] = lambda reading, target, step: 0.0,
    ) -> None:
        """`command`: (3,) m/s, m/s, rad/s. `reward`: of a reading, by the target (n,) that led to it."""
        self._actor = actor
        self._seeing = seeing
        self._fallen = fallen
        self._command = command
        self._clock = clock
        self._reward = reward
        self._joints = actor.joints
        self.period = actor.period
        self.shaper = actor.shaper
        actor.begin()
        self.figures = PolicyStatistics()
        self.holding: str | None = None  # why, while it holds
        self._since = self._looked = inf  # s: when this hold began, and was looked at last
        self._seen: StateMessage | None = None  # in this hold: what a later state is compared with

    def step(self, state: StateMessage | None, deadline: float) -> PolicySetpoint | NoSetpoint | PolicyEnd:
        """Return the action of the period that began at `deadline`, from the newest state.

        This is a setpoint, a hold or the end of the drive. `state` None: no state has come yet.
        """
        now = self._clock()
        why = "no state has come yet" if state is None else state.stale(now, STALE, self._joints)
        if state is None or why is not None:
            return self.hold(str(why))
        reading = self._seeing.reading(state)
        self._look(reading)
        if self._fallen(reading):
            tilt = self.figures.tilt
            height = float(reading.height)
            return PolicyEnd(
                f"fallen: the base is {tilt:.0f} degrees from upright, {height:.2f} m above the soles"
            )
        if self.holding is not None:
            still = self._back(state)
            if still is not None:
                return still
        elif self.figures.steps:
            self.figures.judged += 1
            self.figures.returned += self._reward(reading, self.shaper.target, self.figures.steps - 1)
        return self._drive(state, reading, deadline)

    def record_acceptance(self) -> None:
        """The gate took the last setpoint: the drive goes on."""
        if self.holding is not None:
            self.figures.held += self._clock() - self._looked
        self.figures.steps = self.figures.steps + 1
        self.holding = None

    def record_missed_periods(self, periods: int, *, lapsed: bool) -> None:
        """So many periods had no setpoint: the loop went on by the last one, or holds if that has lapsed."""
        if self.holding is None and lapsed:
            self.hold(f"{periods} periods were missed: the last setpoint has lapsed")
        elif self.holding is None:
            self.shaper.coast(periods)

    def hold(self, reason: str) -> NoSetpoint | PolicyEnd:
        """Send nothing for now; the end, where that goes on for too long."""
        now = self._clock()
        if self.holding is None:
            self._since = now
            self.figures.holds = self.figures.holds + 1
            self._seen = None
        else:
            self.figures.held += now - self._looked
        self._looked = now
        self.holding = reason
        if now - self._since > PATIENCE:
            return PolicyEnd(f"held for {PATIENCE:g} s: {reason}")
        return NoSetpoint(reason)

    def _drive(
        self, state: StateMessage, reading: BodyReading, deadline: float
    ) -> PolicySetpoint | NoSetpoint | PolicyEnd:
        began = self._clock()
        try:
            action = self._actor.act(reading, self._command, self.figures.steps)
        except InvalidInput as error:
            return PolicyEnd(f"the policy gives no action: {error}")
        ended = self._clock()
        self.figures.inference = ended - began
        if isinstance(action, str):
            return self.hold(action)
        if not ended - deadline <= LATE * self.period:
            late = (ended - deadline) * 1e3
            self.figures.too_late += 1
            return self.hold(f"the action came {late:.1f} ms late, bound {LATE * self.period * 1e3:g} ms")
        self.figures.source = state.time
        target, velocity = self._actor.shape(action)
        return PolicySetpoint(target - velocity * self.period, velocity)

    def _back(self, state: StateMessage) -> NoSetpoint | PolicyEnd | None:
        """None: it rests in reach, and the drive goes on from there."""
        before = self._seen
        if before is not None and not self._later(state, before):
            return self.hold(str(self.holding))  # the same state, or nearly: it says nothing new
        self._seen = state
        if before is None or not (np.abs(state.goal - before.goal) <= RESTING).all():  # nor a goal unknown
            return self.hold(str(self.holding))
        stray = np.maximum(self.shaper.lower - state.goal, state.goal - self.shaper.upper)
        joint = int(np.argmax(stray))
        if not stray[joint] <= STRAY:
            return PolicyEnd(f"{self._joints[joint]} rests {stray[joint]:.2f} rad out of the policy's reach")
        self._actor.begin(state.goal)
        return None

    def _later(self, state: StateMessage, before: StateMessage) -> bool:
        return state.sequence > before.sequence and state.time - before.time >= APART * self.period

    def _look(self, reading: BodyReading) -> None:
        tilt = degrees(acos(float(np.clip(-reading.gravity[2], -1.0, 1.0))))
        self.figures.tilt = tilt
        self.figures.most_tilt = max(self.figures.most_tilt, tilt)
