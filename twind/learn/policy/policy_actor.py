"""Seam between the loop of a drive and a policy: readings in, raw actions out, targets for the gate.

`TrainedActor` is the policy of `twindctl train`; `twind/learn/cards/` has those of other frameworks.
"""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from twind.learn.policy.policy_card import PolicyCard
from twind.learn.task.action_shaping import ActionShaper
from twind.learn.task.learning_tasks import LearningTask
from twind.learn.task.observation import BodyReading, ObservationBuilder
from twind.learn.task.observation_layout import ObservationLayout
from twind.robot.arrays import Floats

EXCESS = 1e-5  # above 1, of an action: rounding
Action = NDArray[np.float32]


class TargetSource(Protocol):
    """Joint targets that are sent: arrays (n,), rad."""

    target: Floats  # the last one

    @property
    def default(self) -> Floats:
        """Pose in which a drive begins."""

    @property
    def lower(self) -> Floats:
        """Lowest targets."""

    @property
    def upper(self) -> Floats:
        """Highest targets."""

    def coast(self, periods: int) -> None:
        """Follow what the loop did by itself in periods without a setpoint."""


class PolicyActor(Protocol):
    """A policy on one robot. Keeps what the next action depends on."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints of the robot, in its order."""

    @property
    def period(self) -> float:
        """Time between two actions, s."""

    @property
    def shaper(self) -> TargetSource:
        """Targets that it sends."""

    def begin(self, goal: Floats | None = None) -> None:
        """Begin at rest on `goal` (n,), rad, or on the default pose: nothing of earlier steps counts."""

    def act(self, reading: BodyReading, command: Floats, step: int) -> Action | str:
        """Return the action for a reading; a text: why there is none now.

        `command` (3,): m/s, m/s, rad/s. Raises InvalidInput: the network gives none.
        """

    def shape(self, action: Action) -> tuple[Floats, Floats]:
        """Return the target (n,) at the end of the period, rad, and the velocity towards it, rad/s.

        The action then counts as the last one.
        """


class ActionSource(Protocol):
    """Source of actions."""

    card: PolicyCard

    def act(self, observation: Action) -> Action:
        """Return the action (n,) in -1..1 for an observation (N,). Raises InvalidInput."""


class TrainedActor:
    """A policy of `twindctl train`, in the shape that it was trained in."""

    def __init__(self, policy: ActionSource, task: LearningTask) -> None:
        """`task`: its phases and the ramp of its command begin anew with each start from rest."""
        card = policy.card
        default = np.array(card.default)
        self.joints = card.joints
        self.period = card.shaping.period
        self.shaper = ActionShaper(card.limits, default, card.shaping)
        self._policy = policy
        self._task = task
        self._phases = task.phases(self.period)
        self._first: int | None = None  # step of the first action since it was at rest
        self._observer = ObservationBuilder(ObservationLayout(card.joints), default)
        self._action = np.zeros(len(card.joints), np.float32)

    def begin(self, goal: Floats | None = None) -> None:
        """Begin at rest; the last action is that whose target is `goal`."""
        self.shaper.reset(goal)
        self._first = None
        away = np.zeros(len(self.joints)) if goal is None else goal - self.shaper.default
        self._action = np.clip(away / self.shaper.shaping.reach, -1.0, 1.0).astype(np.float32)

    def act(self, reading: BodyReading, command: Floats, step: int) -> Action | str:
        """Return the action for a reading, in -1..1."""
        if self._first is None:
            self._first = step
        since = step - self._first
        phase = self._phases[since % len(self._phases)]
        asked = command * self._task.share(since, self.period)
        seen = self._observer.observe(reading, self._action, self.shaper.target, asked, phase)
        finite = np.isfinite(seen)
        if not finite.all():
            entry = self._observer.layout.names[int(np.argmin(finite))]
            return f"entry {entry} of the observation is not finite"
        action = self._policy.act(seen)
        good = np.abs(action) <= 1.0 + EXCESS  # NaN is not
        if not good.all():
            joint = int(np.argmin(good))
            return f"the action of {self.joints[joint]} is {action[joint]:g}, not in -1..1"
        return action

    def shape(self, action: Action) -> tuple[Floats, Floats]:
        """Return the smoothed target and the velocity towards it."""
        self._action = action
        target, velocity = self.shaper.step(action)
        return target, velocity.copy()
