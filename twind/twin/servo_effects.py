"""Effects of identified servos that no element of MuJoCo describes, laid over a simulation before each step.

Friction near rest (Stribeck) and under load, the dead band of the position loop, the sag of the supply, and
the play between encoder and joint. Arrays are (n,) in joint order.
"""

import mujoco
import numpy as np

from twind.robot.arrays import Floats, Ints
from twind.twin.binding import Binding
from twind.twin.gear_friction import outside_torque
from twind.twin.mirror import index

STRIBECK_SPEED = 0.1  # rad/s: the friction near rest has fallen to 1/e; between published fits of servos
LEAST_SUPPLY = 0.2  # share of the supply that a sag leaves at least
_DYNAMIC = ("stribeck_nm", "load_friction_per_nm", "dead_band_rad", "sag_per_nm")


def servo_effects(binding: Binding, model: mujoco.MjModel) -> "ServoEffects | None":
    """Return the effects that the identified model of this robot has; None: it has none.

    `model`: a copy of the binding's, which `ServoEffects.apply` changes at each step.
    """
    table = {name: _column(binding, name) for name in _DYNAMIC}
    return ServoEffects(binding, model, table) if any(column.any() for column in table.values()) else None


def backlash_of(binding: Binding) -> Floats | None:
    """Return the identified play of each joint (n,), rad, whole width; None: no joint has any."""
    play = _column(binding, "backlash_rad")
    return play if play.any() else None


def _column(binding: Binding, name: str) -> Floats:
    found = {} if binding.robot.identified is None else binding.robot.identified.estimates(name)
    return np.array([found[joint].value if joint in found else 0.0 for joint in binding.robot.names])


def servo_rows(model: mujoco.MjModel, addresses: Ints) -> Ints:
    """Return the actuators whose controls stand at `addresses` (n,) of ctrl."""
    return np.searchsorted(model.actuator_ctrladr, addresses)


class ServoEffects:
    """Works out friction, stiffness and torque limit of each joint before a step of the physics."""

    def __init__(self, binding: Binding, model: mujoco.MjModel, table: dict[str, Floats]) -> None:
        """`table`: the columns of `_DYNAMIC`."""
        self._model = model
        self._qpos = index(binding.qpos)
        self._dofs = index(binding.dof)
        self._actuators = index(servo_rows(model, binding.actuators))
        self._goals = DelayedGoals(model, servo_rows(model, binding.actuators), binding.actuators)
        self._stribeck, self._load, dead_band, self._sag = (table[name] for name in _DYNAMIC)
        self._half = dead_band / 2.0
        self._rubs, self._bears, self._dead, self._sags = (bool(table[name].any()) for name in _DYNAMIC)
        self._dry = model.dof_frictionloss[self._dofs].copy()
        self._stiffness = model.actuator_gainprm[self._actuators, 0].copy()
        self._range = model.actuator_forcerange[self._actuators].copy()

    def apply(self, data: mujoco.MjData) -> None:
        """Set what acts in the next step, from the state and the forces of the last one."""
        model = self._model
        rows = self._actuators
        torque = data.actuator_force[rows]
        if self._rubs or self._bears:
            friction = self._dry
            if self._rubs:
                share = data.qvel[self._dofs] * (1.0 / STRIBECK_SPEED)
                friction = friction + self._stribeck * np.exp(-share * share)
            if self._bears:
                carried = torque - outside_torque(model, data, self._dofs)
                friction = friction + self._load * (carried * carried)
            model.dof_frictionloss[self._dofs] = friction
        stiffness = self._stiffness
        if self._sags:
            supply = np.maximum(1.0 - self._sag * np.abs(torque), LEAST_SUPPLY)
            stiffness = stiffness * supply
            model.actuator_gainprm[rows, 0] = stiffness
            model.actuator_biasprm[rows, 1] = -stiffness
            model.actuator_forcerange[rows] = self._range * supply[:, None]
        if self._dead:
            error = self._goals.read(data) - data.qpos[self._qpos]
            band = np.minimum(np.maximum(error, -self._half), self._half)  # clip takes four times as long
            model.actuator_biasprm[rows, 0] = -stiffness * band


class DelayedGoals:
    """Reads the goals on which servos act in the next step, from MuJoCo's history of controls.

    `mj_readCtrl` of all of them at once: a call for each joint takes six times as long.
    """

    def __init__(self, model: mujoco.MjModel, actuators: Ints, addresses: Ints) -> None:
        """`addresses` (n,): of the goals in ctrl, which have no history where there is no delay."""
        delay = model.actuator_delay[actuators]
        self._addresses = addresses
        self._late = np.flatnonzero(delay > 0.0)
        rows = actuators[self._late]
        self._count = model.actuator_history[rows, 0].astype(np.int64)
        self._newest = model.actuator_historyadr[rows].astype(np.int64) + 1
        self._values = self._newest + 1 + self._count
        lag = np.maximum(delay[self._late] / model.opt.timestep - 1.0, 0.0)  # the newest is one step old
        self._whole = lag.astype(np.int64)
        self._share = lag - self._whole

    def read(self, data: mujoco.MjData) -> Floats:
        """Return the goals (n,), rad."""
        goals: Floats = data.ctrl[self._addresses]
        if len(self._late):
            history = data.history
            after = (history[self._newest].astype(np.int64) - self._whole) % self._count
            before = (after - 1) % self._count
            goals[self._late] = (1.0 - self._share) * history[self._values + after]
            goals[self._late] += self._share * history[self._values + before]
        return goals


class EncoderPlay:
    """Positions that encoders show: they stay behind their joints by up to half of the play."""

    def __init__(self, play: Floats, position: Floats) -> None:
        """`play` (n,): rad, whole width; `position` (n,): rad, where encoder and joint agree."""
        self._half = play / 2.0
        self._shown = np.array(position)

    def show(self, position: Floats) -> Floats:
        """Return the readings (n,) for joints at `position` (n,), after those of all calls before."""
        self._shown = np.clip(self._shown, position - self._half, position + self._half)
        return self._shown
