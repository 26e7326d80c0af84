"""Mass held at a body of the robot, from the torque that the identified model does not explain. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from twind.exceptions import InvalidInput
from twind.robot.arrays import Floats
from twind.twin.binding import Binding

SHARE = 0.3  # of the mass that its deviation may be
FINE = 0.05  # kg that it may be in any case


@dataclass(frozen=True, slots=True)
class PayloadEstimate:
    """Mass at the centre of a body, with its standard deviation."""

    mass_kg: float
    sd_kg: float

    @property
    def determined(self) -> bool:
        """True where the deviation is small against the mass, or small at all."""
        return self.sd_kg <= max(SHARE * abs(self.mass_kg), FINE)


def estimate_payload(
    binding: Binding,
    body: str,
    positions: Sequence[Floats],
    torques: Sequence[Floats],
    deviations: Sequence[Floats],
) -> PayloadEstimate:
    """Fit one mass to torques from outside in one or more poses; rows (n,): rad, N·m, N·m.

    The deviations are mostly of friction and of the model, alike in all rows: more rows of one pose do not
    make the result surer, other poses do. Raises InvalidInput: no such body, or no joint feels its weight.
    """
    model = binding.model
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, body)
    if number <= 0:
        names = ", ".join(model.body(each).name for each in range(1, model.nbody))
        raise InvalidInput(f"no body {body!r}; there are {names}")
    data = mujoco.MjData(model)
    jacobian = np.zeros((3, model.nv))
    weight = fit = 0.0
    for position, torque, deviation in zip(positions, torques, deviations, strict=True):
        data.qpos[binding.qpos] = position
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacBodyCom(model, data, jacobian, None, number)
        leverage = (model.opt.gravity @ jacobian)[binding.dof]  # N·m per kg
        share = leverage / deviation**2
        weight += float(share @ leverage) / len(positions)
        fit += float(share @ torque) / len(positions)
    if not weight > 0.0:
        raise InvalidInput(f"no joint carries the weight of {body} in this pose: stretch the arm sideways")
    return PayloadEstimate(fit / weight, float(weight**-0.5))
