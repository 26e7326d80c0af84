"""A robot to simulate, from the answer of `GetRobot`, as recordings hold it. Executes nothing of it."""

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
from twind.twin.binding import Binding


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
        model = _compiled(mjcf, os.path.dirname(str(robot["mjcf_path"])))
        model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE  # as `bind`
        joints = [model.joint(each["model_joint"]).id for each in robot["joints"]]
        names = tuple(str(each["name"]) for each in robot["joints"])
        found = RecordedBinding(
            robot=RecordedRobot(names, str(robot["base"]), _identified(robot.get("identified"))),
            model=model,
            qpos=model.jnt_qposadr[joints].astype(np.int64),
            dof=model.jnt_dofadr[joints].astype(np.int64),
            actuators=np.array([_actuator(model, joint) for joint in joints], np.int64),
            rest=np.array([float(robot["poses"]["rest"][name]) for name in names]),
            floating=robot["support"] == "free",
        )
    except (KeyError, TypeError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise InvalidInput(f"its robot cannot be simulated ({reason}): name the robot by --robot") from None
    return cast("Binding", found)  # the rest of it concerns buses and limits


def _compiled(mjcf: str, folder: str) -> Any:
    spec = mujoco.MjSpec.from_string(mjcf)
    spec.modelfiledir = folder  # of its meshes
    return spec.compile()


def _identified(told: object) -> IdentifiedModel | None:
    return None if told is None else msgspec.convert(told, IdentifiedModel)


def _actuator(model: Any, joint: int) -> int:
    driving = np.flatnonzero(
        (model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT) & (model.actuator_trnid[:, 0] == joint)
    )
    if len(driving) != 1:
        raise ValueError(f"joint {model.joint(joint).name!r} has {len(driving)} actuators")
    return int(model.actuator_ctrladr[driving[0]])
