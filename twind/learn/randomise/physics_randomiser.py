"""A draw applied to the physics: to a model of one's own, or to one simulation of a batch.

Only fields whose range is not neutral are written; each from the model as it was compiled, never from the
last draw. An encoder's zero moves the joint's reference and its stops: `qpos` then is what the encoder says,
the body hangs where the joint really is, and no step costs more.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from twind.learn.randomise.randomisation_ranges import SAME, ZERO, EpisodeDraw, RandomisationRanges, Span
from twind.robot.arrays import Floats, Ints

Fields = Mapping[str, Any]  # of a model, or of one simulation: name -> array
SETCONST: frozenset[str] = frozenset(mujoco.MjModel._setconst_inputs)


@dataclass(frozen=True, slots=True)
class ModelAddresses:
    """Ids and addresses in a model of what is randomised, in joint order."""

    links: Ints  # (b,), bodies of the robot
    base: int  # body
    joints: Ints  # (n,)
    qpos: Ints  # (n,)
    dof: Ints  # (n,)
    base_qpos: int  # of the free joint: place, then quaternion
    base_dof: int
    actuators: Ints  # (n,), affine position servos: gain kp, bias 0 -kp -kv
    imu: Ints  # sensors


def _friction(new: Fields, old: Fields, draw: EpisodeDraw, at: ModelAddresses) -> None:
    new["geom_friction"][:, 0] = old["geom_friction"][:, 0] * draw.friction


def _mass(new: Fields, old: Fields, draw: EpisodeDraw, at: ModelAddresses) -> None:
    new["body_mass"][at.links] = old["body_mass"][at.links] * draw.mass
    new["body_inertia"][at.links] = old["body_inertia"][at.links] * draw.mass[:, None]


def _centre_of_mass(new: Fields, old: Fields, draw: EpisodeDraw, at: ModelAddresses) -> None:
    new["body_ipos"][at.base] = old["body_ipos"][at.base] + draw.centre_of_mass
    new["body_sameframe"][at.base] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE  # else it is taken for the origin


def _armature(new: Fields, old: Fields, draw: EpisodeDraw, at: ModelAddresses) -> None:
    new["dof_armature"][at.dof] = old["dof_armature"][at.dof] * draw.armature


def _damping(new: Fields, old: Fields, draw: EpisodeDraw, at: ModelAddresses) -> None:
    new["dof_damping"][at.dof] = old["dof_damping"][at.dof] * draw.damping


def _frictionloss(new: Fields, old: Fields, draw: EpisodeDraw, at: ModelAddresses) -> None:
    new["dof_frictionloss"][at.dof] = old["dof_frictionloss"][at.dof] * draw.frictionloss


def _stiffness(new: Fields, old: Fields, draw: EpisodeDraw, at: ModelAddresses) -> None:
    gain = old["actuator_gainprm"][at.actuators, 0] * draw.stiffness
    new["actuator_gainprm"][at.actuators, 0] = gain
    new["actuator_biasprm"][at.actuators, 1] = -gain


def _braking(new: Fields, old: Fields, draw: EpisodeDraw, at: ModelAddresses) -> None:
    new["actuator_biasprm"][at.actuators, 2] = old["actuator_biasprm"][at.actuators, 2] * draw.braking


def _encoder_zero(new: Fields, old: Fields, draw: EpisodeDraw, at: ModelAddresses) -> None:
    new["qpos0"][at.qpos] = old["qpos0"][at.qpos] + draw.encoder_zero
    new["jnt_range"][at.joints] = old["jnt_range"][at.joints] + draw.encoder_zero[:, None]


def _action_delay(new: Fields, old: Fields, draw: EpisodeDraw, at: ModelAddresses) -> None:
    new["actuator_delay"][at.actuators] = in_steps(draw.action_delay, float(old["opt.timestep"]))


def _imu_delay(new: Fields, old: Fields, draw: EpisodeDraw, at: ModelAddresses) -> None:
    new["sensor_delay"][at.imu] = in_steps(draw.imu_delay, float(old["opt.timestep"]))


def in_steps(delay: float | Floats, timestep: float) -> float | Floats:
    """Delays of whole steps as MuJoCo needs them: half a step less.

    It takes the last sample that is at least that old, and sums of steps are not whole multiples of a step:
    a delay of exactly three steps would now and then be four.
    """
    steps = np.rint(np.divide(delay, timestep))
    whole: float | Floats = np.maximum(0.0, (steps - 0.5) * timestep)
    return whole


@dataclass(frozen=True, slots=True)
class ModelChange:
    """Way of one quantity of a draw into the model: the fields that `write` writes."""

    quantity: str
    neutral: Span
    fields: tuple[str, ...]
    write: Callable[[Fields, Fields, EpisodeDraw, ModelAddresses], None]


CHANGES = (
    ModelChange("friction", SAME, ("geom_friction",), _friction),
    ModelChange("mass", SAME, ("body_mass", "body_inertia"), _mass),
    ModelChange("centre_of_mass", ZERO, ("body_ipos", "body_sameframe"), _centre_of_mass),
    ModelChange("armature", SAME, ("dof_armature",), _armature),
    ModelChange("damping", SAME, ("dof_damping",), _damping),
    ModelChange("frictionloss", SAME, ("dof_frictionloss",), _frictionloss),
    ModelChange("stiffness", SAME, ("actuator_gainprm", "actuator_biasprm"), _stiffness),
    ModelChange("braking", SAME, ("actuator_biasprm",), _braking),
    ModelChange("encoder_zero", ZERO, ("qpos0", "jnt_range"), _encoder_zero),
    ModelChange("action_delay", ZERO, ("actuator_delay",), _action_delay),
    ModelChange("imu_delay", ZERO, ("sensor_delay",), _imu_delay),
)


class PhysicsRandomiser:
    """Writer of draws into one model. Keeps the compiled values; `fields`: those that it writes."""

    def __init__(self, ranges: RandomisationRanges, model: Any, at: ModelAddresses) -> None:
        """`model`: mujoco.MjModel as compiled. Raises ValueError: it has no room for the longest delay."""
        self._at = at
        self._changes = [each for each in CHANGES if ranges.varies(each.quantity, each.neutral)]
        self.fields = tuple(dict.fromkeys(name for each in self._changes for name in each.fields))
        self.derived = any(name in SETCONST for name in self.fields)
        old = {name: np.array(getattr(model, name)) for name in self.fields}
        self._old: Fields = {**old, "opt.timestep": np.array(model.opt.timestep)}
        step = float(model.opt.timestep)
        _require_room(model.actuator_history[at.actuators, 0], ranges.longest_action_delay, step, "actuators")
        _require_room(model.sensor_history[at.imu, 0], ranges.imu_delay[1], step, "IMU sensors")

    def write(self, draw: EpisodeDraw, fields: Fields) -> None:
        """Write `draw` into `fields`; the caller lets MuJoCo derive its constants if `derived`."""
        for each in self._changes:
            each.write(fields, self._old, draw, self._at)


class SingleModelWriter:
    """Draws applied to one model, which is this one's to change."""

    def __init__(self, physics: PhysicsRandomiser, model: Any) -> None:
        self._physics = physics
        self._model = model
        self._fields = {name: getattr(model, name) for name in physics.fields}
        self._scratch = mujoco.MjData(model) if physics.derived else None

    def apply(self, draw: EpisodeDraw) -> None:
        """From now on the model is as drawn; the next reset of its data begins there."""
        self._physics.write(draw, self._fields)
        if self._scratch is not None:
            mujoco.mj_setConst(self._model, self._scratch)


class BatchModelWriter:
    """Draws applied to the simulations of a `mujoco.batch.Batch`, each to its own."""

    def __init__(self, physics: PhysicsRandomiser, batch: Any) -> None:
        self._physics = physics
        self._batch = batch
        self._fields = {name: batch.expand(name) for name in physics.fields}

    def apply(self, ids: Ints, draws: list[EpisodeDraw]) -> None:
        """From now on the simulations `ids` (sorted) are as drawn."""
        for at, draw in zip(ids, draws, strict=True):
            self._physics.write(draw, {name: field[at] for name, field in self._fields.items()})
        if self._physics.derived:
            self._batch.set_const(ids)


def _require_room(samples: Ints, delay: float, step: float, whose: str) -> None:
    needed = round(delay / step)
    if samples.size and samples.min() < needed:
        raise ValueError(
            f"the {whose} keep {samples.min()} samples, a delay of {delay:g} s needs {needed}: "
            "compile the model with the longest delay of its ranges"
        )
