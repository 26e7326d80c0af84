"""A policy that bends the knees of the standing robot."""

import numpy as np

from twind.config.robot_file import load_robot
from twind.learn.policy.policy_file import NetworkLayer, PolicyCard
from twind.learn.task.action_shaping import ActionShaping
from twind.learn.task.plant_model import plant_of

PLANT = plant_of(load_robot("h24-standing"), period=0.02)
CARD = PolicyCard.for_training(
    "Stand", "h24-standing", PLANT.layout, PLANT.binding.limits, PLANT.default, ActionShaping()
)


def bending(size: float = 0.3) -> list[NetworkLayer]:
    """Knees that bend and stretch for ever: a rotation of two of the last actions, in both legs."""
    names = CARD.joints
    at = PLANT.layout.places["action"].start
    weight = np.zeros((len(names), PLANT.layout.size), np.float32)
    bias = np.zeros(len(names), np.float32)
    one = names.index("l_knee")
    two = names.index("head_yaw")
    turn = 2.0 * np.pi / 100.0
    weight[one, [at + one, at + two]] = np.cos(turn), -np.sin(turn)
    weight[two, [at + one, at + two]] = np.sin(turn), np.cos(turn)
    bias[one] = size * turn
    for name, share in (("r_knee", 1.0), ("hip_pitch", -0.5), ("ankle_pitch", -0.5)):
        for joint in [name] if name == "r_knee" else [f"l_{name}", f"r_{name}"]:
            weight[names.index(joint)] = share * weight[one]
            bias[names.index(joint)] = share * bias[one]
    return [NetworkLayer(weight, bias)]
