"""Hands that lift, tilt and set down a robot's base, by force and torque, in place of a body's support."""

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from twind.robot.arrays import Floats
from twind.twin.mujoco_physics import MujocoPhysics

STIFF = 400.0  # 1/s², of the place, and of the attitude by an inertia of 0.05 kg m²
LOOSE = 40.0  # 1/s
INERTIA = 0.05  # kg m²

# seconds since the hands took it -> m above the start, rad of tilt forward and to the left
Carry = Callable[[float], tuple[float, float, float]]


class Hands:
    """Carries the base of `body` along `carry`; everything else goes to the support, which has let go."""

    pushing = True  # else no step is reported

    def __init__(self, body: MujocoPhysics, base: str, carry: Carry) -> None:
        self._body = body
        self._support: Any = body.crane
        self._support.let_go()
        self._carry = carry
        self._base = int(body.model.body(base).id)
        self._weight = float(body.model.body_subtreemass[self._base])
        self._start = np.array(body.data.qpos[:3])
        self._time = 0.0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._support, name)

    def let_go(self) -> None:
        """Leave the base to itself, and the body to its support."""
        self._body.data.xfrc_applied[self._base] = 0.0
        self._body.crane = self._support

    def stepped(self) -> None:
        """Apply the force of the next step."""
        data = self._body.data
        self._time += float(self._body.model.opt.timestep)
        up, forward, left = self._carry(self._time)
        place = self._start + np.array([0.0, 0.0, up])
        turn: Floats = np.zeros(4)
        mujoco.mju_euler2Quat(turn, np.array([-left, forward, 0.0]), "xyz")
        error: Floats = np.zeros(3)
        back: Floats = np.zeros(4)
        mujoco.mju_negQuat(back, data.qpos[3:7])
        difference: Floats = np.zeros(4)
        mujoco.mju_mulQuat(difference, turn, back)
        mujoco.mju_quat2Vel(error, difference, 1.0)
        rate = data.xmat[self._base].reshape(3, 3) @ data.qvel[3:6]
        pull = STIFF * (place - data.qpos[:3]) - LOOSE * data.qvel[:3] + np.array([0.0, 0.0, 9.81])
        data.xfrc_applied[self._base, :3] = self._weight * pull
        data.xfrc_applied[self._base, 3:] = INERTIA * (STIFF * error - LOOSE * rate)
