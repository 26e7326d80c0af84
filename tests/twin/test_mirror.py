"""The mirror shows what was measured, and nothing that was not."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.support.examples import examples
from twind.config.robot_file import load_robot
from twind.robot.arrays import Bools, Floats
from twind.robot.joint_state import JointState
from twind.twin.binding import bind
from twind.twin.mirror import TwinMirror

ROBOT = load_robot("h24")
BINDING = bind(ROBOT, None)
BACKWARDS = bind(replace(ROBOT, joints=ROBOT.joints[::-1]), None)
COUNT = 24
KNEE = ROBOT.names.index("l_knee")


def reading(position: Floats, velocity: Floats | None = None, fresh: Bools | None = None) -> JointState:
    return JointState(
        time=1.0,
        position=position,
        velocity=np.zeros(COUNT) if velocity is None else velocity,
        effort=np.full(COUNT, np.nan),
        age=np.zeros(COUNT),
        heard=np.ones(COUNT, np.bool_) if fresh is None else fresh,
    )


poses = arrays(np.float64, COUNT, elements=st.floats(-2.0, 2.0))


@examples(25)
@given(poses)
def test_every_body_stands_where_forward_kinematics_puts_it(pose: Floats) -> None:
    mirror = TwinMirror(BINDING)
    mirror.update(reading(pose))
    data = mujoco.MjData(BINDING.model)
    data.qpos[BINDING.qpos] = pose
    mujoco.mj_kinematics(BINDING.model, data)
    assert np.allclose(mirror.data.xpos, data.xpos, atol=1e-12)
    assert np.allclose(mirror.data.xquat, data.xquat, atol=1e-12)
    assert (mirror.position == pose).all()


def test_joints_are_found_by_name_not_by_place() -> None:
    pose = np.linspace(-0.5, 0.5, COUNT)
    there = TwinMirror(BINDING)
    back = TwinMirror(BACKWARDS)
    there.update(reading(pose))
    back.update(reading(pose[::-1].copy()))
    assert np.allclose(there.data.xpos, back.data.xpos)
    assert np.allclose(there.effort, back.effort[::-1])


def test_the_model_torque_is_that_of_gravity_at_rest() -> None:
    pose = np.zeros(COUNT)
    pose[ROBOT.names.index("l_hip_pitch")] = -1.2
    mirror = TwinMirror(BINDING)
    mirror.update(reading(pose))
    data = mujoco.MjData(BINDING.model)
    data.qpos[BINDING.qpos] = pose
    mujoco.mj_forward(BINDING.model, data)
    assert np.allclose(mirror.effort, data.qfrc_bias[BINDING.dof], atol=1e-9)
    assert -1.3 < mirror.effort[ROBOT.names.index("l_hip_pitch")] < -0.9  # holds 0.95 kg of leg, 0.12 m out


def test_contacts_and_joint_stops_put_no_torque_into_the_mirror() -> None:
    pose = np.zeros(COUNT)
    pose[KNEE] = 2.6  # beyond the stop of the model, and the foot in the thigh
    mirror = TwinMirror(BINDING)
    mirror.update(reading(pose))
    assert np.abs(mirror.effort).max() < 3.0
    assert mirror.data.ncon == 0
    assert mirror.data.nefc <= COUNT  # dry friction alone


def test_the_shared_model_keeps_its_contacts() -> None:
    before = BINDING.model.opt.disableflags
    TwinMirror(BINDING)
    assert BINDING.model.opt.disableflags == before == 0


def test_stale_joints_keep_their_last_position_in_the_mirror() -> None:
    mirror = TwinMirror(BINDING)
    mirror.update(reading(np.full(COUNT, 0.1)))
    heard = np.ones(COUNT, np.bool_)
    heard[KNEE] = False
    mirror.update(reading(np.full(COUNT, 0.2), fresh=heard))
    assert mirror.position[KNEE] == 0.1
    assert (np.delete(mirror.position, KNEE) == 0.2).all()
    mirror.update(reading(np.full(COUNT, 0.3), fresh=np.zeros(COUNT, np.bool_)))
    assert (np.delete(mirror.position, KNEE) == 0.2).all()
    assert mirror.refused == 0


def test_the_torque_of_a_joint_never_read_is_unknown() -> None:
    mirror = TwinMirror(BINDING)
    assert np.isnan(mirror.effort).all()
    heard = np.zeros(COUNT, np.bool_)
    heard[KNEE] = True
    mirror.update(reading(np.full(COUNT, np.nan), fresh=np.zeros(COUNT, np.bool_)))
    assert np.isnan(mirror.effort).all()
    mirror.update(reading(np.full(COUNT, 0.1), fresh=heard))
    assert np.isfinite(mirror.effort[KNEE])
    assert np.isnan(np.delete(mirror.effort, KNEE)).all()
    mirror.update(reading(np.full(COUNT, 0.1)))
    assert np.isfinite(mirror.effort).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300, 1e3])
@pytest.mark.parametrize("where", ["position", "velocity"])
def test_a_non_finite_reading_never_enters_the_model(bad: float, where: str) -> None:
    mirror = TwinMirror(BINDING)
    mirror.update(reading(np.full(COUNT, 0.1)))
    position = np.full(COUNT, 0.2)
    velocity = np.zeros(COUNT)
    (position if where == "position" else velocity)[KNEE] = bad * (1.0 if where == "position" else 10.0)
    mirror.update(reading(position, velocity))
    assert mirror.position[KNEE] == 0.1
    assert (np.delete(mirror.position, KNEE) == 0.2).all()
    assert mirror.refused == 1
    for array in (mirror.data.qpos, mirror.data.qvel, mirror.data.xpos, mirror.data.qfrc_inverse):
        assert np.isfinite(array).all()


@examples(25)
@given(
    arrays(np.float64, COUNT, elements=st.floats(allow_nan=True, allow_infinity=True)),
    arrays(np.float64, COUNT, elements=st.floats(allow_nan=True, allow_infinity=True)),
    arrays(np.bool_, COUNT),
)
def test_the_model_stays_finite_for_any_reading(position: Floats, velocity: Floats, fresh: Bools) -> None:
    mirror = TwinMirror(BINDING)
    mirror.update(reading(position, velocity, fresh))
    assert np.isfinite(mirror.data.xpos).all()
    assert np.isfinite(mirror.data.qfrc_inverse).all()
    untouched = ~(fresh & np.isfinite(position) & np.isfinite(velocity))
    assert (mirror.position[untouched] == BINDING.rest[untouched]).all()


def test_a_jump_of_the_pose_leaves_no_trace() -> None:
    straight = np.zeros(COUNT)
    bent = np.full(COUNT, 0.4)
    jumped = TwinMirror(BINDING)
    direct = TwinMirror(BINDING)
    for pose in (bent, straight, bent):
        jumped.update(reading(pose))
    direct.update(reading(bent))
    assert np.array_equal(jumped.effort, direct.effort)
