"""Reward of a moment, and the test for a fall: one set of formulas, for one robot and for many.

They are arithmetic on columns (`observation.columns`), floats of one robot or arrays of many.
"""

from collections.abc import Callable
from functools import cached_property
from importlib.util import find_spec
from math import nan
from typing import Any

import numpy as np

from twind.learn.task.learning_tasks import LearningTask
from twind.learn.task.observation import BodyReading, columns
from twind.learn.task.plant_model import Plant
from twind.robot.arrays import Floats

UPRIGHT = 0.5  # cosine of the tilt of the base beyond which the robot has fallen: 60 degrees
LOW = 0.6  # share of its standing height below which it has
SPEED = 0.15  # m/s: an error of this size halves its kernel
TURN = 0.5  # rad/s
LIFT = 0.02  # m
PER_SPEED = SPEED**-2
PER_TURN = TURN**-2
PER_LIFT = LIFT**-2

Column = Any  # a float, or an array (…,)


class RewardFunction:
    """Judges one robot, or `shape` robots, by the weights of a task."""

    def __init__(self, task: LearningTask, plant: Plant, shape: tuple[int, ...] = ()) -> None:
        n = len(plant.default)
        self._task = task
        self._low = LOW * plant.height
        self._origin = np.zeros((*shape, 2 * n))
        self._origin[..., :n] = plant.default
        self._plant = plant
        # Scaled so that the sum of squares is the mean square.
        soft = 0.5 * sum(task.stiffness)  # values drawn around it cannot be measured from outside
        self._stiffness = soft * plant.stiffness / np.sqrt(n)
        self._braking = plant.braking / np.sqrt(n)
        self._share = 1.0 / n
        self._most = 1.0 / np.sqrt(n)
        self._all = np.zeros((*shape, 3, n))  # way from the default pose, velocity, torque
        self._joints = self._all.reshape(*shape, 3 * n)[..., : 2 * n]
        self._torque = self._all[..., 2, :]
        self._brake = np.zeros((*shape, n))

    def reward(
        self, reading: BodyReading, target: Floats, command: Floats, phase: Floats
    ) -> tuple[Column, dict[str, Column]]:
        """The reward (…,) of the control step that led here, and its terms by name: they add up to it.

        `target` (…, n) was sent for it, rad; `command` (…, 3), `phase` (…, 4).
        """
        return self._worth(columns(reading.base), reading, target, command, phase)

    def per_step(self, command: Floats, phases: Floats) -> Callable[[BodyReading, Floats, int], float]:
        """Make the reward of one robot for a reading, the target (n,) that led to it, and the step's number.

        `command` grows as the task has it; `phases`: (k, 4) of the steps, again and again. NaN where the gait
        that is imitated cannot be had, for want of the extra walk.
        """
        if self._task.imitates and find_spec("mink") is None:
            return lambda *_: nan
        _ = self._reference  # it takes seconds: now, not in a step
        period = self._task.shaping.period

        def reward(reading: BodyReading, target: Floats, step: int) -> float:
            asked = command * self._task.share(step, period)
            return float(self.reward(reading, target, asked, phases[step % len(phases)])[0])

        return reward

    @cached_property
    def _reference(self) -> Any:
        """The gait that is imitated, or None. Worked out when the first reward is: it takes seconds."""
        if not self._task.imitates:
            return None
        from twind.learn.task.gait_reference import GaitReference  # needs the extra walk

        return GaitReference(self._plant.binding.robot, self._task.stride, self._task.shaping.period)

    def fallen(self, reading: BodyReading) -> Column:
        """The base is tilted too far, or too low: bool, or (…,)."""
        return self._down(columns(reading.base))

    def verdict(
        self, reading: BodyReading, target: Floats, command: Floats, phase: Floats
    ) -> tuple[Column, dict[str, Column], Column]:
        """`reward` and `fallen` together."""
        c = columns(reading.base)
        return *self._worth(c, reading, target, command, phase), self._down(c)

    def _down(self, c: Any) -> Column:
        return (c[8] > -UPRIGHT) | (c[9] < self._low)

    def _worth(
        self, c: Any, reading: BodyReading, target: Floats, command: Floats, phase: Floats
    ) -> tuple[Column, dict[str, Column]]:
        weigh = self._task.weights
        moving = self._task.stride > 0.0
        forward, left, turn = columns(command)
        if self._reference is not None:
            self._origin[..., : self._joints.shape[-1] // 2] = self._reference.positions(phase, command)
        pose, motion, torque = columns(self._squares(reading, target))
        ahead = c[10] - forward
        aside = c[11] - left
        spin = c[2] - turn
        terms = {
            "alive": weigh.alive + 0.0 * spin,
            "velocity": weigh.velocity / (1.0 + (ahead * ahead + aside * aside) * PER_SPEED),
            "turn": weigh.turn / (1.0 + spin * spin * PER_TURN),
            "upright": -weigh.upright * c[8],
            "energy": weigh.energy * torque,
            "pose": weigh.pose * self._share * pose,
            "motion": weigh.motion * self._share * motion,
        }
        if moving:
            terms["gait"] = weigh.gait * self._gait(c, columns(phase))
        return sum(terms.values()), terms

    def _gait(self, c: Any, phase: Any) -> Column:
        """Return the match of the feet with their phases: the swinging one lifted, the other down."""
        height = c[9]
        x = c[6]
        y = c[7]
        z = c[8]
        left = phase[0]
        right = phase[2]
        rise = 0.5 * self._task.clearance
        one = height - (c[13] * x + c[14] * y + c[15] * z) - rise * (left + abs(left))
        other = height - (c[16] * x + c[17] * y + c[18] * z) - rise * (right + abs(right))
        return 1.0 / (1.0 + (one * one + other * other) * PER_LIFT)

    def _squares(self, reading: BodyReading, target: Floats) -> Floats:
        """(…, 3): sums of squares of the way from the default pose and of velocity, mean square of torque.

        The torque is what a servo of the task's middle gain makes of its lag and its speed, as a share of the
        most it has, 1 at most: known on a robot too, whose servos report no torque.
        """
        np.subtract(reading.joints, self._origin, self._joints)
        np.subtract(target, reading.position, self._torque)
        np.multiply(self._torque, self._stiffness, self._torque)
        np.multiply(reading.velocity, self._braking, self._brake)
        np.subtract(self._torque, self._brake, self._torque)
        self._torque.clip(-self._most, self._most, self._torque)
        found: Floats = np.vecdot(self._all, self._all)
        return found
