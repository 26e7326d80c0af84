"""Gait of the walking engine as a table over phase and command: what a policy that walks is to imitate."""

import math
from typing import Any

import numpy as np

from twind.config.robot_spec import RobotFile
from twind.exceptions import InvalidInput
from twind.learn.task.learning_tasks import LearningTask
from twind.learn.task.plant_model import Plant
from twind.robot.arrays import Floats
from twind.twin.binding import bind
from twind.walk.balance import BalanceGains
from twind.walk.gait_pattern import GaitSettings
from twind.walk.leg_kinematics import soles_of
from twind.walk.walking_engine import WalkingEngine, WalkSettings

SPEEDS = (0.0, 0.05, 0.1, 0.15, 0.2)  # m/s forward, of the rows of the table
LEFT = 0.03  # m/s
TURN = 0.2  # rad/s
WHOLE = np.array([0.1, 0.03, 0.25])  # m/s, m/s, rad/s: below such a command the whole gait becomes smaller
CREEP = 1e-5  # m/s: the engine steps in place
SETTLED = 8  # steps after which the gait repeats itself
LONGEST = 60.0  # s until then


class GaitReference:
    """Positions of all joints, rad, of a gait in a cycle of `stride` s: the left foot swings first.

    Between commands it is linear. A command of zero is the stance; towards it the gait shrinks.
    """

    def __init__(self, robot: RobotFile, stride: float, period: float) -> None:
        """`period`: s, of a control step. Raises InvalidInput: a robot that the engine cannot walk."""
        self._robot = robot
        self._settings = WalkSettings(gait=GaitSettings(step_s=0.5 * stride))
        self._period = period
        self._count = round(stride / period)
        self.stance = WalkingEngine(robot, self._settings).stance
        rows = [self._cycle((max(speed, CREEP), 0.0, 0.0)) for speed in SPEEDS]
        self._forward = np.array(rows) - self.stance  # (speeds, count, n)
        middle = SPEEDS[len(SPEEDS) // 2]
        self._left = self._slope((middle, LEFT, 0.0), (middle, -LEFT, 0.0), LEFT)  # (count, n), per m/s
        self._turn = self._slope((middle, 0.0, TURN), (middle, 0.0, -TURN), TURN)  # per rad/s

    def positions(self, phase: Floats, command: Floats, ahead: int = 0) -> Floats:
        """Return the positions (…, n) `ahead` control steps after `phase` (…, 4) for `command` (…, 3)."""
        turn = np.arctan2(phase[..., 0], phase[..., 1]) / (2.0 * np.pi)
        at = np.rint(turn * self._count).astype(np.int64) + ahead
        row = at % self._count
        size = np.sqrt(((command / WHOLE) ** 2).sum(axis=-1))
        share = np.minimum(size, 1.0)[..., None]
        full = command / np.maximum(share, 1e-9)
        place = np.interp(full[..., 0], SPEEDS, np.arange(len(SPEEDS)))
        low = np.minimum(place.astype(np.int64), len(SPEEDS) - 2)
        weight = (place - low)[..., None]
        gait = self._forward[low, row] * (1.0 - weight) + self._forward[low + 1, row] * weight
        gait += self._left[row] * full[..., 1:2] + self._turn[row] * full[..., 2:3]
        found: Floats = self.stance + share * gait
        return found

    def _slope(
        self, more: tuple[float, float, float], less: tuple[float, float, float], size: float
    ) -> Floats:
        return (self._cycle(more) - self._cycle(less)) / (2.0 * size)

    def _cycle(self, command: tuple[float, float, float]) -> Floats:
        """Return the goals (count, n) of one stride of the engine without feedback.

        Raises InvalidInput: an engine that does not repeat itself within `LONGEST`.
        """
        engine = WalkingEngine(self._robot, self._settings)
        wanted = np.array(command)
        steps = 0
        for _ in range(round(LONGEST / self._period)):
            goals = engine.advance(self._period, wanted)
            begun = engine.steps != steps and engine.steps % 2 == 0  # both feet have stepped
            steps = engine.steps
            if begun and steps >= SETTLED:
                break
        else:
            raise InvalidInput(
                f"a stride of {self._count * self._period:g} s: no {SETTLED} steps in {LONGEST:g} s"
            )
        rest = [engine.advance(self._period, wanted) for _ in range(self._count - 1)]
        return np.array([goals, *rest])


class GaitTeacher:
    """Actions of the reference with feedback by the ankles, from observations alone."""

    def __init__(self, task: LearningTask, plant: Plant) -> None:
        """`task`: one that imitates. Raises InvalidInput: a robot that the engine cannot walk."""
        robot = plant.binding.robot
        self._reference = GaitReference(robot, task.stride, task.shaping.period)
        self._places = plant.layout.places
        self._default = plant.default
        self._reach = task.shaping.reach
        self._gains = BalanceGains()
        self._soles = soles_of(bind(robot, None), self._reference.stance)
        self._lifted = GaitSettings().double_support

    def act(self, rows: Any) -> Any:
        """Return actions (k, n) for observations (k, N), not normalised."""
        values = np.asarray(rows, np.float64)
        phase = values[:, self._places["phase"]]
        goals = self._reference.positions(phase, values[:, self._places["command"]], 1)
        base = values[:, self._places["base"]]
        gyro = base[:, 0:3]
        up = -base[:, 6:9]
        gains = self._gains
        pitch = gains.pitch * np.arctan2(-up[:, 0], up[:, 2]) + gains.pitch_rate * gyro[:, 1]
        roll = gains.roll * np.arctan2(up[:, 1], up[:, 2]) + gains.roll_rate * gyro[:, 0]
        for foot, sole in enumerate(self._soles):
            turn = np.arctan2(phase[:, 2 * foot], phase[:, 2 * foot + 1]) % (2.0 * math.pi) / math.pi
            carries = (turn < self._lifted) | (turn >= 1.0)  # `turn`: in step times, its swing from 0 to 1
            goals[:, sole.ankle_pitch] += sole.pitch_sign * np.where(carries, pitch, 0.0)
            goals[:, sole.ankle_roll] += sole.roll_sign * np.where(carries, roll, 0.0)
        return np.clip((goals - self._default) / self._reach, -1.0, 1.0)
