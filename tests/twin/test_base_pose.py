"""Pose of a held base of a virtual robot: gravity turned in its frame, and a bench below a lying robot."""

import numpy as np
import pytest

from twind.config.robot_file import load_robot
from twind.twin.base_pose import BASES, UPRIGHT, gravity
from twind.twin.mujoco_physics import MujocoPhysics, body_of

H24 = load_robot("h24")


def body(base: str) -> MujocoPhysics:
    return body_of(H24, dict.fromkeys(H24.names, 2048), base=base)


def angles(one: MujocoPhysics) -> dict[str, float]:
    return {name: float(one.data.joint(name).qpos[0]) for name in H24.names}


def test_gravity_keeps_its_strength_whichever_way_the_base_is_held() -> None:
    for base in BASES:
        assert np.linalg.norm(gravity(base, np.array([0.0, 0.0, -3.7]))) == pytest.approx(3.7)
    assert gravity(UPRIGHT, np.array([0.0, 0.0, -9.81])).tolist() == [0.0, 0.0, -9.81]
    assert gravity("back", np.array([0.0, 0.0, -9.81]))[0] < 0.0  # what is in front of it points up


def test_on_its_back_the_limbs_rest_on_a_bench_and_without_torque_nothing_falls_further() -> None:
    one = body("back")
    assert one.data.ncon > 0
    before = angles(one)
    assert max(abs(angle) for angle in before.values()) < 0.2
    one.advance(1.0)
    assert angles(one) == pytest.approx(before, abs=0.01)


def test_a_body_that_is_laid_down_falls_the_other_way() -> None:
    one = body(UPRIGHT)
    assert max(abs(angle) for angle in angles(one).values()) < 1e-3
    one.set_base_pose("back")
    one.advance(1.0)
    assert angles(one)["l_hip_pitch"] > 0.3  # nobody holds it, and there is no bench
    one.set_base_pose(UPRIGHT)
    one.advance(6.0)
    assert angles(one)["l_hip_pitch"] < 0.15
    with pytest.raises(KeyError):
        one.set_base_pose("head")
