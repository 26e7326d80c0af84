import dataclasses
import math

import numpy as np
import pytest

from twind.config.calibration_file import load_calibration
from twind.config.counts import angle_of, tick_range
from twind.config.robot_file import load_robot
from twind.exceptions import InvalidInput
from twind.twin.mujoco_physics import body_of
from twind.virtual.bench_servos import servo
from twind.virtual.virtual_robot_spec import buses, make_spec, save
from twind_drivers.virtual.virtual_servos import ServoSpec


def test_zeros_differ_are_always_the_same_and_keep_clear_of_the_seam() -> None:
    robot = load_robot("h24")
    zeros = make_spec(robot).zeros
    assert zeros == make_spec(robot).zeros
    assert len(set(zeros.values())) > 12
    for joint in robot.joints:
        low, high = tick_range(joint, zeros[joint.name], joint.lower - 0.08, joint.upper + 0.08)
        assert 32 <= low < high <= 4095 - 32


@pytest.mark.parametrize("name", ["h24", "h24-split"])
@pytest.mark.parametrize("physics", [True, False])
def test_every_servo_rests_at_the_rest_pose_of_the_robot_file(name: str, physics: bool) -> None:
    robot = load_robot(name)
    made = make_spec(robot)
    for bus, virtual in buses(made, physics=physics).items():
        virtual.servos.settle(0.0)
        present = virtual.servos.readings.position.get()
        for row, joint in enumerate(made.joints(bus)):
            angle = angle_of(joint, made.zeros[joint.name], int(present[row]))
            assert angle == pytest.approx(robot.poses["rest"][joint.name], abs=0.005)
            assert virtual.servos.registers.id_of(row) == joint.id


def test_the_fitting_calibration_is_read_back_unchanged(tmp_path) -> None:
    robot = load_robot("h24")
    made = make_spec(robot)
    save(made, tmp_path / "one.yaml")
    found = load_calibration(tmp_path / "one.yaml", robot)
    assert {joint.name: joint.zero_ticks for joint in found.joints} == made.zeros
    servos = buses(made, physics=False)["main"].servos
    for row, joint in enumerate(found.joints):
        assert joint.device.min_ticks == servos["min_position_limit"][row]
        assert joint.device.max_ticks == servos["max_position_limit"][row]
    with pytest.raises(InvalidInput, match=r"NAME\.yaml"):
        save(made, tmp_path / "one.txt")


def test_baud_and_return_delay_go_into_the_registers() -> None:
    made = make_spec(load_robot("h24"), baud=1_000_000, return_delay_us=250)
    servos = buses(made, physics=False)["main"].servos
    assert set(servos["baud_rate"].tolist()) == {3}
    assert servos.registers.delays([0]) == pytest.approx([250e-6])
    assert servos.baud == 1_000_000


@pytest.mark.parametrize(
    ("baud", "delay"), [(1_234_567, 0), (1_000_000, 3), (1_000_000, 510), (1_000_000, -2)]
)
def test_an_impossible_servo_setting_is_refused(baud: int, delay: int) -> None:
    with pytest.raises(InvalidInput, match=r"9600|508"):
        make_spec(load_robot("h24"), baud=baud, return_delay_us=delay)


def test_a_travel_that_does_not_fit_one_turn_is_refused() -> None:
    robot = load_robot("h24")
    wide = dataclasses.replace(robot.joints[0], lower=-math.pi, upper=math.pi)
    with pytest.raises(InvalidInput, match="does not fit one turn"):
        make_spec(dataclasses.replace(robot, joints=(wide, *robot.joints[1:])))


@pytest.mark.parametrize("physics", [True, False])
def test_the_legs_of_the_mixed_robot_rest_at_the_rest_pose_of_the_robot_file(physics: bool) -> None:
    robot = load_robot("h24-mixed")
    made = make_spec(robot)
    virtual = buses(made, physics=physics)
    assert {name: bus.kind for name, bus in virtual.items()} == {
        "upper": "dynamixel2",
        "l_leg": "can",
        "r_leg": "can",
    }
    for bus in ("l_leg", "r_leg"):
        virtual[bus].advance(0.1)
        assert virtual[bus].ids() == [1, 2, 3, 4, 5, 6]
        for joint, told in zip(made.joints(bus), virtual[bus].truth(0.1), strict=True):
            angle = angle_of(joint, made.zeros[joint.name], told["position"])
            assert angle == pytest.approx(robot.poses["rest"][joint.name], abs=0.005)
            assert not told["torque"]


def test_can_zeros_keep_the_travel_on_the_turn_of_the_start() -> None:
    robot = load_robot("h24-mixed")
    zeros = make_spec(robot).zeros
    legs = [joint for joint in robot.joints if joint.bus != "upper"]
    assert len({zeros[joint.name] for joint in legs}) > 6
    for joint in legs:
        low, high = tick_range(joint, zeros[joint.name], joint.lower - 0.08, joint.upper + 0.08)
        assert -8192 + 32 <= low < high <= 8191 - 32


def test_servos_cannot_hang_on_a_can_bus() -> None:
    made = make_spec(load_robot("h24-mixed"))
    bus, spec = servo("l_leg:9:XM430-W350")
    assert isinstance(spec, ServoSpec)
    with pytest.raises(InvalidInput, match="l_leg is a bus of kind can: it takes no further devices"):
        buses(made, physics=False, extra={bus: [spec]})


def test_a_leg_of_the_body_goes_where_it_is_commanded() -> None:
    """Its model's own servos have ranges for their goals: those must not bound a torque."""
    robot = load_robot("h24-mixed")
    made = make_spec(robot)
    leg = body_of(robot, made.zeros).impedance(
        [at for at, each in enumerate(robot.joints) if each.bus == "l_leg"]
    )
    one = np.ones(6)
    goal = leg.position.copy()
    goal[3] += 0.3
    leg.drive(one > 0, goal, 0.0 * one, 200.0 * one, 3.0 * one, 0.0 * one, 10.0 * one)
    leg.advance(1.0)
    assert np.abs(leg.position - goal).max() < 0.005
