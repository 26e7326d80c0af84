"""MuJoCo as muscles: a pendulum of one servo, and the whole h24."""

from math import asin, pi
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support import transmission_robot_file as linked
from tests.support.examples import examples
from tests.support.mujoco_servo_rig import ARMS, power
from twind.config.robot_file import load_robot
from twind.exceptions import InvalidInput, OperationFailed
from twind.twin.mujoco_physics import MujocoPhysics, ServoMotor, body_of

TICKS = 4096 / (2 * pi)


def arms(friction: float = 0.1, **start: float) -> MujocoPhysics:
    text = ARMS.format(friction=friction, actuator="one").replace("<position ", '<position name="one" ')
    motors = [ServoMotor("one", 2000.0, TICKS), ServoMotor("two", 1000.0, -TICKS)]
    return MujocoPhysics(mujoco.MjSpec.from_string(text), motors, pinned=True, start=start)


def test_ticks_follow_zero_and_sign() -> None:
    muscles = arms()
    power(muscles)
    muscles.set_goals(np.array([2000.0 + 200, 1000.0 + 200]))
    muscles.advance(1.0)
    q = muscles.data.qpos
    assert q[0] == pytest.approx(-q[1], abs=1e-6)
    assert muscles.position == pytest.approx([2000 + q[0] * TICKS, 1000 - q[1] * TICKS])


def test_the_error_under_load_is_that_of_the_register_gain() -> None:
    """P 800: 18.9 N·m/rad; 0.98 N·m level, friction may carry a part of it either way."""
    muscles = arms(friction=0.0)
    power(muscles)
    level = np.array([2000.0 + 1024, 1000.0])
    muscles.set_goals(level)
    muscles.advance(4.0)
    sag = (level[0] - muscles.position[0]) / TICKS
    stiffness = 800 / 128 * TICKS / 885 * 4.1
    load = 0.5 * 9.81 * 0.2 * np.cos(sag)
    assert stiffness == pytest.approx(18.9, abs=0.1)
    assert sag == pytest.approx(load / stiffness, abs=0.05 / stiffness + 1e-3)


def test_the_integral_gain_takes_the_error_away() -> None:
    muscles = arms()
    power(muscles, i=3000)
    muscles.set_goals(np.array([2000.0 + 1024, 1000.0]))
    muscles.advance(5.0)
    assert abs(muscles.position[0] - 3024) < 3


def test_the_integral_gain_adds_its_share_once_a_millisecond_and_ends_with_torque() -> None:
    """e-manual, "Position PID Gain": I / 65536; that its loop runs once a millisecond is assumed."""
    muscles = arms()
    muscles.block(np.array([True, True]))
    power(muscles, p=0, i=100)
    muscles.set_goals(muscles.position + np.array([200.0, 0.0]))
    muscles.advance(1.0)
    assert muscles.pwm[0] == pytest.approx(100 / 65536 * 200 * 1000, rel=0.01)
    power(muscles, on=False)
    muscles.advance(1.1)
    assert muscles.pwm[0] == muscles.current[0] == 0.0


@pytest.mark.parametrize(("pwm", "current"), [(60, 1193), (885, 58)])
def test_the_caps_of_pwm_and_current_bound_the_torque(pwm: float, current: float) -> None:
    """Both leave 0.28 N·m: friction and cap together hold the arm below asin((0.28 + 0.1) / 0.98)."""
    muscles = arms()
    power(muscles, pwm=pwm, current=current)
    muscles.set_goals(np.array([2000.0 + 1024, 1000.0]))
    muscles.advance(4.0)
    angle = (muscles.position[0] - 2000) / TICKS
    assert asin((0.27 - 0.1) / 0.981) < angle < asin((0.29 + 0.1) / 0.981)
    assert abs(muscles.current[0]) <= max(current, 60)


def test_speed_ends_at_what_the_motor_runs_free() -> None:
    muscles = arms()
    power(muscles)
    fastest = 0.0
    muscles.set_goals(np.array([2000.0 + 3 * 4096, 1000.0]))
    for k in range(200):
        muscles.advance(0.005 * k)
        fastest = max(fastest, abs(muscles.velocity[0]))
    assert 150 < fastest < 280, "201 raw is 46 rpm; gravity helps on the way down"


def test_without_torque_an_arm_hangs_down_and_friction_holds_it_there() -> None:
    muscles = arms(one=1.2)
    resting = muscles.position.copy()
    angle = abs(resting[0] - 2000) / TICKS
    assert angle < asin(0.1 / 0.981) * 1.5, "it came down before time began"
    muscles.advance(60.0)
    assert np.abs(muscles.position - resting).max() < 0.5
    assert np.abs(muscles.current).max() == 0.0


def test_parts_of_one_body_share_its_time() -> None:
    muscles = arms()
    begun = muscles.data.time
    first = muscles.part([0])
    second = muscles.part([1])
    power(first)
    first.set_goals(np.array([2200.0]))
    first.advance(1.0)
    assert first.position[0] == pytest.approx(2200, abs=20)
    power(second)
    second.set_goals(np.array([900.0]))
    second.advance(2.0)
    assert second.position[0] == pytest.approx(900, abs=20)
    assert muscles.data.time == pytest.approx(begun + 2.0), "2 s for both"


def test_advancing_in_pieces_is_the_same_as_at_once() -> None:
    ends = []
    for pieces in ([1.0], [0.001, 0.0035, 0.2, 0.7777, 1.0]):
        muscles = arms()
        power(muscles)
        muscles.set_goals(np.array([2500.0, 900.0]))
        for until in pieces:
            muscles.advance(until)
        ends.append(muscles.position.copy())
    assert (ends[0] == ends[1]).all()


def test_what_a_model_s_own_servos_inherit_does_not_reach_the_motors(tmp_path: Path) -> None:
    """A range to inherit is none of a transmission's shafts: the model did not compile."""
    inherited = '<default><position inheritrange="1" timeconst="0.1" gear="3"/></default><worldbody>'
    body = linked.BODY.replace("<worldbody>", inherited)
    robot = linked.read_robot(linked.write(tmp_path, body=body))
    model = body_of(robot, {joint.name: joint.type.centre for joint in robot.joints}).model
    assert model.na == 0
    assert (model.actuator_gear[:, 0] == 1.0).all()


def test_a_body_that_does_not_compile_is_refused_by_its_reason() -> None:
    spec = mujoco.MjSpec.from_string(
        "<mujoco><worldbody><body><joint name='elbow'/><geom size='1' mass='0'/></body></worldbody></mujoco>"
    )
    with pytest.raises(InvalidInput, match="mass and inertia of moving bodies"):
        MujocoPhysics(spec, [ServoMotor("elbow", 0, TICKS)], pinned=True)


def test_a_joint_the_model_lacks_is_named() -> None:
    spec = mujoco.MjSpec.from_string(
        "<mujoco><worldbody><body><joint name='knee'/><geom size='1'/></body></worldbody></mujoco>"
    )
    with pytest.raises(KeyError, match="no joint 'elbow'; it has knee"):
        MujocoPhysics(spec, [ServoMotor("elbow", 0, TICKS)], pinned=True)


def test_physics_that_blew_up_is_an_error_not_a_reset() -> None:
    muscles = arms()
    muscles.data.qvel[0] = 1e30
    with pytest.raises(OperationFailed, match="QVEL"):
        muscles.advance(0.1)


def test_h24_holds_its_poses_with_small_error_and_does_not_creep() -> None:
    robot = load_robot("h24")
    muscles = body_of(robot, {joint.name: 2048 for joint in robot.joints})
    assert np.abs(muscles.position - 2048).max() < 2, "its rest pose is at rest"
    gains = robot.joints[0].type.gains
    power(muscles, p=gains.p)
    now = 0.0
    for pose in ("stand", "arms_out"):
        angles = np.array([robot.poses[pose][joint.name] * joint.sign for joint in robot.joints])
        muscles.set_goals(2048 + angles * TICKS)
        now += 3.0
        muscles.advance(now)
        held = muscles.position.copy()
        assert np.abs(held - 2048 - angles * TICKS).max() < 20
        now += 3.0
        muscles.advance(now)
        assert np.abs(muscles.position - held).max() < 0.5


# ---------------------------------------------------------------------- modes


def test_in_current_mode_the_current_is_the_goal_at_any_speed_that_the_voltage_allows() -> None:
    """e-manual, "Operating Mode" 0: only the current is controlled, whatever speed and position do."""
    muscles = arms(friction=0.0)
    power(muscles, mode=0)
    muscles.set_goals(np.array([100.0, -50.0]))  # 0.48 and 0.24 N·m: no more than leans the arms aside
    for k in range(1, 100):
        muscles.advance(0.02 * k)
        assert muscles.current == pytest.approx([100.0, -50.0], abs=8)
    muscles.advance(15.0)
    assert muscles.position[0] - 2000 > 200
    assert muscles.position[1] - 1000 < -100
    lean = np.abs(np.sin((muscles.position - [2000, 1000]) / TICKS)) * 0.981
    assert lean == pytest.approx(np.array([100, 50]) * 1.78 * 0.00269, abs=0.06)


def test_in_velocity_mode_it_turns_at_the_goal_over_the_top_and_down_again() -> None:
    """e-manual, "Velocity PI Gain": the I gain takes the load's error away; either sign, any side."""
    muscles = arms()
    power(muscles, mode=1)
    muscles.set_goals(np.array([80.0, -120.0]))
    muscles.advance(2.0)
    before = muscles.position.copy()
    seen = []
    for k in range(200):
        muscles.advance(2.0 + 0.05 * (k + 1))
        seen.append(muscles.velocity.copy())
    assert np.mean(seen, axis=0) == pytest.approx([80, -120], abs=2)
    turned = (muscles.position - before) / 4096
    assert turned == pytest.approx(np.array([80, -120]) * 0.229 / 60 * 10, rel=0.03)


def test_in_pwm_mode_the_speed_is_what_the_voltage_leaves() -> None:
    """e-manual, "Operating Mode" 16: the output is the goal, the speed whatever comes of it."""
    muscles = arms()
    power(muscles, mode=16)
    muscles.set_goals(np.array([600.0, -600.0]))
    muscles.advance(1.0)
    before = muscles.position.copy()
    muscles.advance(11.0)
    assert muscles.pwm == pytest.approx([600, -600], abs=1)
    speed = (muscles.position - before) / 4096 * 60 / 0.229 / 10
    assert speed == pytest.approx(np.array([1, -1]) * 201 * 600 / 885, rel=0.25)
    power(muscles, mode=16, supply=0.5)
    muscles.set_goals(np.array([600.0, -600.0]))
    muscles.advance(12.0)
    before = muscles.position.copy()
    muscles.advance(22.0)
    slow = (muscles.position - before) / 4096 * 60 / 0.229 / 10
    assert np.abs(slow).max() < 0.6 * np.abs(speed).min(), "half the voltage, less than half the speed"


@pytest.mark.parametrize("cap", [40.0, 150.0])
def test_in_mode_5_the_goal_current_bounds_the_current_on_the_move_and_against_a_block(cap: float) -> None:
    """e-manual, "Current-based Position Control Mode": Goal Current caps what the position loop asks for."""
    muscles = arms()
    power(muscles, mode=5, current=cap)
    worst = 0.0
    for k in range(300):
        if k % 100 == 0:
            muscles.set_goals(np.array([2000.0 + (400 if k % 200 else -900), 1000.0]))
        muscles.advance(0.01 * (k + 1))
        worst = max(worst, np.abs(muscles.current).max())
    assert worst < cap * 1.05 + 5
    muscles.block(np.array([True, True]))
    here = muscles.position.copy()
    muscles.set_goals(here + 3000.0)
    muscles.advance(6.0)
    assert muscles.current == pytest.approx([cap, cap], rel=0.02)
    assert np.abs(muscles.position - here).max() < 10, "something holds it fast"


def test_in_mode_5_braking_from_full_speed_keeps_the_cap_too() -> None:
    """Back-EMF and output then push the same way: up to twice the stall current of 856."""
    muscles = arms(friction=0.0)
    power(muscles, mode=5, current=1000.0)
    muscles.set_goals(muscles.position + 3 * 4096.0)
    muscles.advance(0.6)
    assert np.abs(muscles.velocity).min() > 120
    muscles.set_goals(muscles.position - 3 * 4096.0)
    worst = 0.0
    for k in range(50):
        muscles.advance(0.6 + 0.002 * (k + 1))
        worst = max(worst, np.abs(muscles.current).max())
    assert 900 < worst < 1010


@examples(25)
@given(
    st.sampled_from([0, 1, 3, 4, 5, 16]),
    st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=3),
    st.floats(0, 885),
    st.floats(1, 1193),
    st.floats(0.3, 1.2),
)
def test_any_command_keeps_the_physics_finite_and_inside_its_caps(
    mode: int, goals: list[float], pwm: float, current: float, supply: float
) -> None:
    muscles = arms()
    power(muscles, mode=mode, pwm=pwm, current=current, supply=supply)
    for k, goal in enumerate(goals):
        muscles.set_goals(np.array([goal, -goal]))
        muscles.advance(0.1 * (k + 1))
        assert np.isfinite([muscles.position, muscles.velocity, muscles.current, muscles.pwm]).all()
        assert np.abs(muscles.pwm).max() <= pwm + 1e-6
        if mode in (0, 5):
            assert np.abs(muscles.current).max() <= current * 1.1 + 20, "one step of 2 ms late"
    power(muscles, mode=mode, on=False)
    muscles.advance(0.5)
    assert np.abs(muscles.current).max() == np.abs(muscles.pwm).max() == 0.0, "off means nothing drives"
