"""CAN actuators and serial servos of one body, and the muscles without physics."""

from math import pi

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from tests.support.mujoco_servo_rig import ARMS, power
from twind.twin.mujoco_physics import MujocoPhysics, ServoMotor
from twind_drivers.can.can_units import COUNT, TURN
from twind_drivers.virtual.can.can_motor_physics import INERTIA, CanMotorPhysics, FirstOrderCanPhysics

LEVEL = 0.5 * 9.81 * 0.2  # N·m of one arm when it is level
TICKS = 4096 / (2 * pi)


def body(*, ratio: float = 1.0, sign: int = 1, friction: float = 0.0) -> MujocoPhysics:
    """A serial servo at joint one, a CAN actuator at joint two whose encoder reads 300 where that hangs."""
    text = ARMS.format(friction=friction, actuator="one").replace("<position ", '<position name="one" ')
    ticks = sign * ratio * TURN / (2 * pi)
    can = ServoMotor("two", 300.0, ticks, ratio, speed_lsb=COUNT)
    return MujocoPhysics(
        mujoco.MjSpec.from_string(text), [ServoMotor("one", 2000.0, TICKS), can], pinned=True
    )


def command(
    muscles: CanMotorPhysics, place: float = 0.0, speed: float = 0.0, kp: float = 0.0, kd: float = 0.0,
    torque: float = 0.0, limit: float = 10.0, on: bool = True,
) -> None:  # fmt: skip
    one = np.ones(len(muscles.position))
    muscles.drive(
        one > 0 if on else one < 0, place * one, speed * one, kp * one, kd * one, torque * one, limit * one
    )


def joint(muscles: MujocoPhysics, name: str = "two") -> float:
    return float(muscles.data.joint(name).qpos[0])


@pytest.mark.parametrize(("ratio", "sign"), [(1.0, 1), (1.0, -1), (2.0, 1), (3.0, -1)])
def test_the_error_under_load_is_torque_over_stiffness(ratio: float, sign: int) -> None:
    muscles = body(ratio=ratio, sign=sign)
    part = muscles.impedance([1])
    place = 300 * COUNT + sign * ratio * pi / 2
    command(part, place, kp=20.0 / ratio**2, kd=1.0 / ratio**2)
    part.advance(6.0)
    sag = pi / 2 - joint(muscles)
    assert 20.0 * sag == pytest.approx(LEVEL * np.cos(sag), rel=0.06)  # the least friction holds a part
    assert part.torque[0] * sign * ratio == pytest.approx(20.0 * sag, rel=0.02)
    assert part.position[0] == pytest.approx(300 * COUNT + sign * ratio * joint(muscles))


def test_torque_alone_holds_and_damping_alone_lets_it_sink() -> None:
    muscles = body()
    part = muscles.impedance([1])
    command(part, kd=4.0, torque=LEVEL)
    part.advance(12.0)
    raised = joint(muscles)
    assert raised > 1.0, "so much torque carries the arm almost level"
    command(part, kd=4.0)
    part.advance(12.5)
    sunk = joint(muscles)
    assert 0.05 < raised - sunk < 0.25, "gravity over damping: a quarter of a radian a second at most"
    command(part, on=False)
    part.advance(14.5)
    assert abs(joint(muscles)) < 0.5, "without torque it hangs"


def test_the_limit_is_the_most_it_pulls() -> None:
    muscles = body()
    part = muscles.impedance([1])
    command(part, 300 * COUNT + pi / 2, kp=200.0, kd=5.0, limit=0.5)
    part.advance(5.0)
    assert np.abs(part.torque[0]) == pytest.approx(0.5)
    assert LEVEL * np.sin(joint(muscles)) < 0.5 + 0.06


def test_a_serial_servo_of_the_same_body_is_moved_by_its_own_rules() -> None:
    muscles = body()
    serial = muscles.part([0])
    can = muscles.impedance([1])
    power(serial)
    serial.set_goals(np.array([2000.0 + 300]))
    command(can, 300 * COUNT + 0.4, kp=50.0, kd=1.0)
    for k in range(300):
        serial.advance(k * 0.01)
        can.advance(k * 0.01)
    assert joint(muscles, "one") == pytest.approx(300 / TICKS, abs=0.05)
    assert joint(muscles, "two") == pytest.approx(0.4, abs=0.05)


@examples(20)
@given(st.floats(-3, 3), st.floats(0.5, 500), st.floats(0, 5))
def test_free_shafts_come_to_rest_at_their_goal(place: float, kp: float, kd: float) -> None:
    muscles = FirstOrderCanPhysics(np.zeros(1))
    command(muscles, place, kp=kp, kd=kd)
    muscles.advance(2.0)
    slowest = max((kd + 0.2) / kp, 2 * INERTIA / (kd + 0.2))
    if 12 * slowest < 2.0:
        assert muscles.position[0] == pytest.approx(place, abs=0.02)
        assert abs(muscles.velocity[0]) < 0.1


def test_a_free_shaft_under_torque_runs_at_torque_over_drag_and_a_held_one_pulls() -> None:
    muscles = FirstOrderCanPhysics(np.zeros(1))
    command(muscles, kd=1.8, torque=3.0)
    muscles.advance(2.0)
    assert muscles.velocity[0] == pytest.approx(3.0 / 2.0, rel=1e-3)
    command(muscles, 5.0, kp=100.0, limit=4.0)
    muscles.block(np.array([True]))
    stood = muscles.position[0]
    muscles.advance(3.0)
    assert (muscles.position[0], muscles.velocity[0], muscles.torque[0]) == (stood, 0.0, 4.0)


def test_without_torque_it_coasts_to_rest_and_stays() -> None:
    muscles = FirstOrderCanPhysics(np.array([1.0]))
    muscles.advance(1.0)
    assert muscles.position[0] == 1.0
    command(muscles, speed=5.0, kd=5.0)
    muscles.advance(1.5)
    command(muscles, on=False)
    muscles.advance(4.0)
    assert muscles.torque[0] == 0.0
    assert abs(muscles.velocity[0]) < 1e-6
