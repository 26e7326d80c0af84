"""The built-in body with room for delays, and where it has what is randomised: for tests of randomisation."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import twind.robots
from twind.learn.randomise.physics_randomiser import ModelAddresses

MJCF = Path(twind.robots.__file__).with_name("h24.xml")
ROOM = 8  # samples of history


def body(history: int = ROOM) -> Any:
    """h24 on its floor; `history` samples of each control and sensor."""
    spec = mujoco.MjSpec.from_file(str(MJCF))
    for element in [*spec.actuators, *spec.sensors]:
        element.nsample = history
    return spec.compile()


def places(model: Any) -> ModelAddresses:
    """All joints but the free one, in the model's order."""
    joints = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE)
    return ModelAddresses(
        links=np.arange(1, model.nbody),
        base=1,
        joints=joints,
        qpos=model.jnt_qposadr[joints].astype(np.int64),
        dof=model.jnt_dofadr[joints].astype(np.int64),
        base_qpos=0,
        base_dof=0,
        actuators=np.arange(model.nu),
        imu=np.arange(model.nsensor),
    )
