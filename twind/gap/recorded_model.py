"""A robot to simulate, from the answer of `GetRobot`, as recordings hold it.

Executes nothing of it, but opens the mesh files that its model names.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, cast

import msgspec
import mujoco
import numpy as np

from twind.config.identified_spec import IdentifiedModel
from twind.exceptions import InvalidInput
from twind.robot.arrays import Floats, Ints
from twind.twin.binding import Binding, position_servo
from twind.twin.model_from_text import compile_model


@dataclass(frozen=True, slots=True)
class RecordedRobot:
    """Part of a robot file that a simulation needs."""

    names: tuple[str, ...]
    base: str
    identified: IdentifiedModel | None
    imu: None = None


@dataclass(frozen=True, slots=True)
class RecordedBinding:
    """Part of `Binding` that a simulation needs."""

    robot: RecordedRobot
    model: Any  # mujoco.MjModel
    qpos: Ints
    dof: Ints
    actuators: Ints
    rest: Floats
    floating: bool


def recorded_binding(robot: Mapping[str, Any], mjcf: str) -> Binding:
    """Return what `Simulation` needs of a recorded robot and its compiled model. Raises InvalidInput."""
    try:
        model, meshes_missing = compile_model(mjcf, os.path.dirname(str(robot["mjcf_path"])))
        if meshes_missing:
            raise InvalidInput("its meshes cannot be read")
        model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE  # as `bind`
        joints = [model.joint(each["model_joint"]).id for each in robot["joints"]]
        names = tuple(str(each["name"]) for each in robot["joints"])
        found = RecordedBinding(
            robot=RecordedRobot(names, str(robot["base"]), _identified(robot.get("identified"))),
            model=model,
            qpos=model.jnt_qposadr[joints].astype(np.int64),
            dof=model.jnt_dofadr[joints].astype(np.int64),
            actuators=np.array(
                [position_servo(model, joint, f"joint {model.joint(joint).name!r}") for joint in joints],
                np.int64,
            ),
            rest=np.array([float(robot["poses"]["rest"][name]) for name in names]),
            floating=robot["support"] == "free",
        )
    except (KeyError, TypeError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise InvalidInput(f"its robot cannot be simulated ({reason}): name the robot by --robot") from None
    return cast("Binding", found)  # the rest of it concerns buses and limits


def _identified(recorded: object) -> IdentifiedModel | None:
    return None if recorded is None else msgspec.convert(recorded, IdentifiedModel)
