"""MuJoCo as muscles: a pendulum of one servo, and the whole h24."""

from math import asin, pi

import mujoco
import numpy as np
import pytest

from twind.config.robot_file import load_robot
from twind.twin.muscles import Diverged, Motor, MujocoMuscles, Part, body_of

TICKS = 4096 / (2 * pi)
# 0.5 kg at 0.2 m: 0.98 N·m when level. Two arms side by side, so that one can be on another bus.
ARMS = """<mujoco><compiler angle="radian"/><worldbody>
<body name="a" pos="0 0 1"><freejoint name="root"/><geom size=".01" mass="1"/>
<body><joint name="one" axis="0 1 0" damping="0.02" armature="0.01" frictionloss="{friction}"/>
<geom pos="0 0 -.2" size=".02" mass="0.5"/></body>
<body pos="0 .5 0"><joint name="two" axis="0 1 0" damping="0.02" armature="0.01" frictionloss="{friction}"/>
<geom pos="0 0 -.2" size=".02" mass="0.5"/></body></body></worldbody>
<actuator><position joint="one"/></actuator><sensor><actuatorfrc actuator="{actuator}"/></sensor></mujoco>"""


def arms(friction: float = 0.1, **start: float) -> MujocoMuscles:
    text = ARMS.format(friction=friction, actuator="one").replace("<position ", '<position name="one" ')
    motors = [Motor("one", 2000.0, TICKS), Motor("two", 1000.0, -TICKS)]
    return MujocoMuscles(mujoco.MjSpec.from_string(text), motors, pinned=True, start=start)


def power(
    muscles: MujocoMuscles | Part, p: float = 800, i: float = 0, on: bool = True, **caps: float
) -> None:
    one = np.ones(len(muscles.position))
    muscles.drive(
        on=one > 0 if on else one < 0,
        p=p * one,
        i=i * one,
        d=0 * one,
        pwm_cap=caps.get("pwm", 885) * one,
        current_cap=caps.get("current", 1193) * one,
    )


def test_ticks_follow_zero_and_sign() -> None:
    muscles = arms()
    power(muscles)
    muscles.aim(np.array([2000.0 + 200, 1000.0 + 200]))
    muscles.advance(1.0)
    q = muscles.data.qpos
    assert q[0] == pytest.approx(-q[1], abs=1e-6)
    assert muscles.position == pytest.approx([2000 + q[0] * TICKS, 1000 - q[1] * TICKS])


def test_the_error_under_load_is_that_of_the_register_gain() -> None:
    """P 800: 18.9 N·m/rad; 0.98 N·m level, friction may carry a part of it either way."""
    muscles = arms(friction=0.0)
    power(muscles)
    level = np.array([2000.0 + 1024, 1000.0])
    muscles.aim(level)
    muscles.advance(4.0)
    sag = (level[0] - muscles.position[0]) / TICKS
    stiffness = 800 / 128 * TICKS / 885 * 4.1
    load = 0.5 * 9.81 * 0.2 * np.cos(sag)
    assert stiffness == pytest.approx(18.9, abs=0.1)
    assert sag == pytest.approx(load / stiffness, abs=0.05 / stiffness + 1e-3)


def test_the_integral_gain_takes_the_error_away() -> None:
    muscles = arms()
    power(muscles, i=3000)
    muscles.aim(np.array([2000.0 + 1024, 1000.0]))
    muscles.advance(5.0)
    assert abs(muscles.position[0] - 3024) < 3


@pytest.mark.parametrize(("pwm", "current"), [(60, 1193), (885, 58)])
def test_the_caps_of_pwm_and_current_bound_the_torque(pwm: float, current: float) -> None:
    """Both leave 0.28 N·m: friction and cap together hold the arm below asin((0.28 + 0.1) / 0.98)."""
    muscles = arms()
    power(muscles, pwm=pwm, current=current)
    muscles.aim(np.array([2000.0 + 1024, 1000.0]))
    muscles.advance(4.0)
    angle = (muscles.position[0] - 2000) / TICKS
    assert asin((0.27 - 0.1) / 0.981) < angle < asin((0.29 + 0.1) / 0.981)
    assert abs(muscles.current[0]) <= max(current, 60)


def test_speed_ends_at_what_the_motor_runs_free() -> None:
    muscles = arms()
    power(muscles)
    fastest = 0.0
    muscles.aim(np.array([2000.0 + 3 * 4096, 1000.0]))
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
    first, second = muscles.part([0]), muscles.part([1])
    power(first)
    first.aim(np.array([2200.0]))
    first.advance(1.0)
    assert first.position[0] == pytest.approx(2200, abs=20)
    power(second)
    second.aim(np.array([900.0]))
    second.advance(2.0)
    assert second.position[0] == pytest.approx(900, abs=20)
    assert muscles.data.time == pytest.approx(begun + 2.0), "2 s for both"


def test_advancing_in_pieces_is_the_same_as_at_once() -> None:
    ends = []
    for pieces in ([1.0], [0.001, 0.0035, 0.2, 0.7777, 1.0]):
        muscles = arms()
        power(muscles)
        muscles.aim(np.array([2500.0, 900.0]))
        for until in pieces:
            muscles.advance(until)
        ends.append(muscles.position.copy())
    assert (ends[0] == ends[1]).all()


def test_a_joint_the_model_lacks_is_named() -> None:
    spec = mujoco.MjSpec.from_string(
        "<mujoco><worldbody><body><joint name='knee'/><geom size='1'/></body></worldbody></mujoco>"
    )
    with pytest.raises(KeyError, match="no joint 'elbow'; it has knee"):
        MujocoMuscles(spec, [Motor("elbow", 0, TICKS)], pinned=True)


def test_physics_that_blew_up_is_an_error_not_a_reset() -> None:
    muscles = arms()
    muscles.data.qvel[0] = 1e30
    with pytest.raises(Diverged, match="QVEL"):
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
        muscles.aim(2048 + angles * TICKS)
        now += 3.0
        muscles.advance(now)
        held = muscles.position.copy()
        assert np.abs(held - 2048 - angles * TICKS).max() < 20
        now += 3.0
        muscles.advance(now)
        assert np.abs(muscles.position - held).max() < 0.5
