"""A held mass is found from the torque it makes, with an uncertainty that says when it is not."""

import copy

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from twind.config.robot_file import load_robot
from twind.exceptions import InvalidInput
from twind.robot.arrays import Floats
from twind.twin.binding import bind
from twind.twin.payload_estimate import estimate_payload

BINDING = bind(load_robot("so101"), None)
HAND = "hand"


def carried(mass: float, position: Floats) -> Floats:
    """Torque that a mass at the hand adds, from two inverse dynamics of the model."""
    found = []
    for each in (0.0, mass):
        model = copy.copy(BINDING.model)
        model.body_mass[model.body(HAND).id] += each
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        data = mujoco.MjData(model)
        data.qpos[BINDING.qpos] = position
        mujoco.mj_inverse(model, data)
        found.append(data.qfrc_inverse[BINDING.dof].copy())
    return found[0] - found[1]


@given(st.floats(0.05, 2.0), st.integers(0, 1000))
@examples(20)
def test_a_mass_is_found_from_the_torque_that_it_adds(mass: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    limits = BINDING.limits
    poses = [rng.uniform(limits.lower, limits.upper) for _ in range(3)]
    torques = [carried(mass, pose) for pose in poses]
    deviations = [np.full(len(limits.lower), 0.02)] * 3
    found = estimate_payload(BINDING, HAND, poses, torques, deviations)
    assert found.mass_kg == pytest.approx(mass, rel=1e-6)


def test_more_readings_of_one_pose_are_not_surer_and_large_deviations_determine_nothing() -> None:
    pose = BINDING.rest
    torque = carried(0.5, pose)
    sure = np.full(len(pose), 0.02)
    one = estimate_payload(BINDING, HAND, [pose], [torque], [sure])
    many = estimate_payload(BINDING, HAND, [pose] * 9, [torque] * 9, [sure] * 9)
    assert many.sd_kg == pytest.approx(one.sd_kg) and one.determined
    assert not estimate_payload(BINDING, HAND, [pose], [torque], [sure * 100.0]).determined


def test_an_unknown_body_is_refused_with_those_that_there_are() -> None:
    pose = BINDING.rest
    with pytest.raises(InvalidInput, match=HAND):
        estimate_payload(BINDING, "claw", [pose], [pose], [np.ones(len(pose))])
