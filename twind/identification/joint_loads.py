"""Inertia, weight and coupling that act on each joint along a measured motion.

MuJoCo's inverse dynamics on the bound model, without servos, friction and contacts.
"""

import copy
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.signal import savgol_filter

from twind.robot.arrays import Floats
from twind.twin.binding import Binding

SMOOTHED = 0.09  # s of motion that give one acceleration
SLOPE = 1e-3  # rad, for the derivative of the bias
SPARSE = 4  # samples for each derivative: weight changes slowly


@dataclass(frozen=True, slots=True)
class JointLoads:
    """Loads of n joints at t samples, arrays (t, n) in joint order; see `ResponseWindows`."""

    position: Floats  # rad, smoothed
    velocity: Floats  # rad/s
    acceleration: Floats  # rad/s²
    inertia: Floats  # kg·m², of the links alone
    bias: Floats  # N·m
    slope: Floats  # N·m/rad


def smooth_motion(time: Floats, position: Floats) -> tuple[Floats, Floats, Floats]:
    """Return position, velocity and acceleration (t, n) of evenly sampled readings."""
    spacing = float(np.median(np.diff(time)))
    width = max(5, 2 * round(SMOOTHED / spacing / 2.0) + 1)
    results = (savgol_filter(position, width, 3, deriv, spacing, axis=0) for deriv in (0, 1, 2))
    smooth, speed, acceleration = results
    return smooth, speed, acceleration


def joint_loads(binding: Binding, time: Floats, position: Floats) -> JointLoads:
    """Return the loads along readings `position` (t, n), rad, at even `time` (t,), s; NaN: no reading."""
    smooth, speed, acceleration = smooth_motion(time, without_holes(position))
    model = bare_model(binding)
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0
    dof = binding.dof
    inertia, bias, slope = (np.empty_like(smooth) for _ in range(3))
    matrix = np.empty((model.nv, model.nv))
    for at in range(len(time)):
        data.qpos[binding.qpos] = smooth[at]
        data.qvel[dof] = speed[at]
        data.qacc[:] = 0.0
        data.qacc[dof] = acceleration[at]
        mujoco.mj_inverse(model, data)
        mujoco.mj_fullM(model, data, matrix)
        inertia[at] = np.diagonal(matrix)[dof]
        bias[at] = data.qfrc_inverse[dof] - inertia[at] * acceleration[at]
    rows = np.unique(np.append(np.arange(0, len(time), SPARSE), len(time) - 1))
    coarse = np.array([_slopes(binding, model, data, smooth[row]) for row in rows])
    for joint in range(len(dof)):
        slope[:, joint] = np.interp(np.arange(len(time)), rows, coarse[:, joint])
    return JointLoads(smooth, speed, acceleration, inertia, bias, slope)


def without_holes(position: Floats) -> Floats:
    """Return readings (t, n), interpolated where they are NaN; a joint that never answered is at zero."""
    filled = position.copy()
    for column in filled.T:
        known = np.isfinite(column)
        column[~known] = (
            np.interp(np.flatnonzero(~known), np.flatnonzero(known), column[known]) if known.any() else 0.0
        )
    return filled


def bare_model(binding: Binding) -> mujoco.MjModel:
    """Return a copy of the model that has links and weight only."""
    model = copy.copy(binding.model)
    for table in (model.dof_damping, model.dof_frictionloss, model.dof_armature):
        table[:] = 0.0
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def _slopes(binding: Binding, model: mujoco.MjModel, data: mujoco.MjData, position: Floats) -> Floats:
    """Return the change of each joint's weight by its own angle (n,), N·m/rad."""
    found = np.empty(len(position))
    data.qvel[:] = 0.0
    data.qacc[:] = 0.0
    for joint, address in enumerate(binding.qpos):
        pair = []
        for side in (-SLOPE, SLOPE):
            data.qpos[binding.qpos] = position
            data.qpos[address] += side
            mujoco.mj_inverse(model, data)
            pair.append(float(data.qfrc_inverse[binding.dof[joint]]))
        found[joint] = (pair[1] - pair[0]) / (2.0 * SLOPE)
    return found
