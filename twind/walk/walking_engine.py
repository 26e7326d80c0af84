"""Goals of all joints for a commanded velocity: what `twindctl walk` and `Robot.walk` send."""

from dataclasses import dataclass, field

import numpy as np

from twind.config.robot_spec import RobotFile
from twind.robot.arrays import Floats
from twind.twin.binding import bind
from twind.walk.balance import BalanceGains, ankle_correction
from twind.walk.gait_pattern import GaitPattern, GaitPhase, GaitSettings
from twind.walk.leg_kinematics import LegKinematics

MOST_SAG = 0.12  # rad that the weight may shift a goal
STANCES = ("walk", "stand", "rest")  # poses of the robot file, the first that there is


@dataclass(frozen=True, slots=True)
class WalkSettings:
    """Gait and balance of a robot."""

    gait: GaitSettings = field(default_factory=GaitSettings)
    balance: BalanceGains = field(default_factory=BalanceGains)


class WalkingEngine:
    """Walks one robot from the pose `walk` (else `stand`, `rest`) of its file; it begins and ends at rest."""

    def __init__(self, robot: RobotFile, settings: WalkSettings | None = None) -> None:
        """Raises InvalidInput: a robot that is held, or that has not two legs of six joints."""
        self._settings = settings or WalkSettings()
        binding = bind(robot, None)
        pose = robot.poses[next(name for name in STANCES if name in robot.poses)]
        self.stance = np.array([pose[name] for name in robot.names])
        self._legs = LegKinematics(binding, self.stance)
        mass = self._legs.mass
        self._height = float(mass[2])
        self._pattern = GaitPattern(self._settings.gait, self._legs.feet, mass[:2], self._height)

    @property
    def standing(self) -> bool:
        """True at rest on both feet."""
        return self._pattern.phase is GaitPhase.STANDING

    @property
    def steps(self) -> int:
        """Steps taken so far."""
        return self._pattern.steps

    def advance(
        self, period: float, command: Floats, quaternion: Floats | None = None, gyro: Floats | None = None
    ) -> Floats:
        """Return the goals (n,), rad, after `period` s.

        `command` (3,): forward, left, m/s, and turn, rad/s; zeros: stop and stand. `quaternion` (4,) w x y z
        and `gyro` (3,), rad/s: of the IMU, in the axes of the base; None: without balance.
        """
        target = self._pattern.advance(period, command)
        goals = self._legs.solve(target, self._height, period)
        goals += np.clip(self._legs.gravity_sag(target), -MOST_SAG, MOST_SAG)
        if quaternion is not None and gyro is not None:
            pitch, roll = ankle_correction(self._settings.balance, quaternion, gyro)
            for foot, sole in enumerate(self._legs.soles):
                if target.swing != foot:
                    goals[sole.ankle_pitch] += sole.pitch_sign * pitch
                    goals[sole.ankle_roll] += sole.roll_sign * roll
        return goals
