import dataclasses
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.mujoco_servo_rig import WholeBodyRig
from twind.config.calibration_file import load_calibration
from twind.config.counts import angle_of, tick_range
from twind.config.robot_file import load_robot, read_robot
from twind.config.robot_spec import RobotFile
from twind.exceptions import InvalidInput
from twind.link import link_commands as link
from twind.robot.finding import ReasonCode
from twind.twin.mujoco_physics import body_of
from twind.virtual.bench_servos import servo
from twind.virtual.virtual_robot_spec import buses, calibration, make_spec, save
from twind_drivers.virtual.virtual_servos import ServoSpec

ARM = Path(__file__).parents[2] / "docs" / "examples" / "arm" / "arm.yaml"


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


def arm_with(**changes: Any) -> RobotFile:
    """The example arm, its shoulder otherwise than in the file; in the model it turns ±1.6 rad."""
    robot = read_robot(ARM)
    return replace(robot, joints=(replace(robot.joints[0], **changes), *robot.joints[1:]))


def ends(robot: RobotFile) -> list[float]:
    """Ends (rad) of the travel of the first joint in the calibration that fits."""
    entry = calibration(make_spec(robot)).joints[0]
    return sorted(angle_of(robot.joints[0], entry.zero_ticks, end) for end in entry.sweep_ticks)


def test_the_travel_reaches_from_stop_to_stop_of_the_body() -> None:
    assert ends(arm_with(lower=-1.3, upper=1.2)) == pytest.approx([-1.6, 1.6], abs=0.002)
    assert ends(arm_with(lower=-1.59, upper=1.0)) == pytest.approx([-1.67, 1.6], abs=0.002)


def test_stops_so_wide_that_a_calibration_would_be_doubted_give_the_travel_of_the_limits() -> None:
    assert ends(arm_with(lower=-1.0, upper=0.5)) == pytest.approx([-1.08, 0.58], abs=0.002)


def test_a_body_whose_stops_are_a_turn_apart_keeps_the_travel_of_its_limits(tmp_path: Path) -> None:
    robot = arm_with(lower=-1.0, upper=0.5)
    wide = tmp_path / "wide.xml"
    wide.write_text(robot.mjcf.replace('range="-1.6 1.6"', 'range="-3.1 3.1"'))
    assert ends(replace(robot, mjcf_path=wide)) == pytest.approx([-1.08, 0.58], abs=0.002)


def test_a_zero_keeps_a_travel_from_stop_to_stop_clear_of_the_seam(tmp_path: Path) -> None:
    robot = arm_with(lower=-0.25, upper=4.5)
    far = tmp_path / "far.xml"
    far.write_text(robot.mjcf.replace('range="-1.6 1.6"', 'range="-0.3 5.4"'))
    entry = calibration(make_spec(replace(robot, mjcf_path=far))).joints[0]
    assert entry.sweep_ticks[0] >= 32 and entry.sweep_ticks[1] <= 4095 - 32
    assert entry.seam_margin_ticks >= 32


def test_a_limp_arm_on_its_stop_is_where_its_calibration_knows_it(tmp_path: Path) -> None:
    text = ARM.read_text().replace("mjcf: arm.xml", f"mjcf: {ARM.with_suffix('.xml')}")
    file = tmp_path / "arm.yaml"
    file.write_text(text.replace("limits_rad: [-1.5, 1.5]", "limits_rad: [-1.3, 1.3]"))
    rig = WholeBodyRig(str(file))
    try:
        rig.connect()
        rig.virtual["main"].faults.lay("back")
        rig.seconds(5.0)
        assert abs(float(rig.loop.robot.measured.position[0])) > 1.5
        rig.call(link.AcquireLease)
        (refusal,) = rig.call(link.Arm).parameters["findings"]
        assert (refusal["code"], refusal["joint"]) == (ReasonCode.OUT_OF_LIMIT, 0)  # as a real one's
        rig.virtual["main"].faults.hand(id=1, rad=1.1)
        rig.seconds(5.0)
        rig.call(link.AcquireLease)
        assert rig.call(link.Arm).error is None
    finally:
        rig.close()
