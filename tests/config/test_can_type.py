"""Robot files with CAN buses: what a type and its joints may say, and what is refused by name."""

from dataclasses import replace
from math import isnan
from pathlib import Path

import pytest

from twind.config.robot_file import load_robot, read_robot
from twind.config.robot_spec import RobotFile
from twind.config.yaml_tree import ConfigError
from twind_drivers.can.can_keys import MUTE, TELL_VOLTAGE
from twind_drivers.can.can_models import MODELS
from twind_drivers.can.can_type import CanType
from twind_drivers.can.can_units import COUNT, EFFORT, TURN
from twind_drivers.can.codec_factory import make, ranges_of
from twind_drivers.dynamixel.servo_type import ServoType

LEG = """\
format: twind-robot/1
name: leg
model: {mjcf: leg.xml, base: torso}
buses:
  arm: {kind: dynamixel2}
  leg: {kind: can, bitrate: 1000000, port: "can:slcan:/dev/ttyACM0"}
types:
  dm: {device: DM4340, gains: {kp: 120.0, kd: 3.0}, velocity_limit_rad_s: 4.0}
  xm: {device: XM430-W350, gains: {p: 800, i: 0, d: 0}}
  ak: {device: AK70-10, gains: {kp: 50.0, kd: 1.0}, watchdog: unverified}
  rs: {device: RS01, gains: {kp: 50.0, kd: 1.0}}
  od: {device: ODrive, gains: {kp: 50.0, kd: 1.0}, ranges: {position_rad: 12.5}, watchdog: unverified}
defaults: {type: dm, bus: leg}
joints:
  hip: {id: 1, limits_rad: [-1.0, 1.0]}
  knee: {id: 2, feedback_id: 0x22, sign: -1, ratio: 2.0, limits_rad: [-0.1, 2.2]}
  elbow: {type: xm, bus: arm, id: 1, limits_rad: [-1.0, 1.0]}
poses: {rest: {}}
"""
KNEE = "  knee: {id: 2, feedback_id: 0x22, sign: -1, ratio: 2.0, limits_rad: [-0.1, 2.2]}\n"


def read(folder: Path, text: str) -> RobotFile:
    (folder / "leg.xml").write_text("<mujoco/>")
    (folder / "leg.yaml").write_text(text.replace("0x22", "34"))
    return read_robot(folder / "leg.yaml")


def kind(robot: RobotFile, place: int = 0) -> CanType:
    found = robot.joints[place].type
    assert isinstance(found, CanType)
    return found


def test_a_can_type_has_si_gains_and_the_ranges_of_its_model(tmp_path: Path) -> None:
    robot = read(tmp_path, LEG)
    damiao = kind(robot)
    assert (damiao.family, damiao.gains.kp, damiao.gains.kd) == ("damiao", 120.0, 3.0)
    ranges = damiao.ranges
    assert (ranges.position_rad, ranges.velocity_rad_s, ranges.torque_nm) == (12.5, 8.0, 28.0)
    assert (damiao.torque_limit_nm, damiao.watchdog, damiao.mode) == (28.0, "device", "impedance")
    assert robot.bus("leg").baud == 1_000_000
    assert robot.bus("leg").port == "can:slcan:/dev/ttyACM0"
    assert isinstance(robot.joints[2].type, ServoType)


def test_the_raw_units_of_a_can_type_match_the_driver(tmp_path: Path) -> None:
    damiao = kind(read(tmp_path, LEG))
    assert (damiao.ticks_per_turn, damiao.velocity_lsb_rad_s) == (TURN, COUNT)
    assert (damiao.effort_lsb_nm, damiao.effort_limit_nm, damiao.full_effort) == (EFFORT, 28.0, 28.0 / EFFORT)
    assert (damiao.centre, damiao.goals("impedance", None)) == (0, (-32594, 32594))
    assert damiao.most * COUNT <= 12.5 < (damiao.most + 1) * COUNT
    assert damiao.goals("impedance", (-100, 40_000)) == (-100, 32594)
    assert damiao.operating_mode("impedance") == 1


def test_a_damiao_answers_with_its_master_id(tmp_path: Path) -> None:
    hip, knee, elbow = read(tmp_path, LEG).joints
    assert (hip.id, hip.feedback_id) == (1, 0x11)
    assert (knee.id, knee.feedback_id, knee.sign, knee.ratio) == (2, 0x22, -1, 2.0)
    assert knee.velocity_limit == 2.0  # of the joint: the motor turns twice as fast
    assert (elbow.id, elbow.feedback_id) == (1, None)


@pytest.mark.parametrize(
    ("ours", "message"),
    [
        ("device: DM4341, gains: {kp: 120.0", "types.dm.device: no CAN actuator 'DM4341'; nearest: DM4340"),
        ("device: DM4340, gains: {kp: 501.0", "types.dm.gains.kp: 501 is outside >= 0 and <= 500"),
        ("device: DM4340, gains: {kp: -1.0", "types.dm.gains.kp: -1 is outside"),
        (
            "device: DM4340, mode: position, gains: {kp: 120.0",
            "types.dm.mode: 'position' is none of impedance",
        ),
        ("device: DM4340, return_delay_us: 8, gains: {kp: 120.0", "types.dm.return_delay_us: unknown key"),
        ("device: DM4340, torque_limit_nm: 28.5, gains: {kp: 120.0", "28.5 is outside > 0 and <= 28"),
        ("device: DM4340, ranges: {position_rad: 0.2}, gains: {kp: 120.0", "0.2 is not one of half a turn"),
        (
            "device: DM4340, watchdog: none, gains: {kp: 120.0",
            "types.dm.watchdog: a DM4340 has a watchdog: write `device`",
        ),
        ("device: DM4340, supply: {warn_v: 20}, gains: {kp: 120.0", "a DM4340 does not tell its voltage"),
        ("device: DM4340, heat: {warn_c: 120}, gains: {kp: 120.0", "120 is outside > 0 and <= 100"),
        ("device: AK70-10, gains: {kp: 120.0", "types.dm.watchdog: a AK70-10 cannot show over the bus"),
        (
            "device: ODrive, watchdog: unverified, gains: {kp: 120.0",
            "ranges.position_rad: missing: no source",
        ),
    ],
)
def test_an_invalid_can_type_is_refused(tmp_path: Path, ours: str, message: str) -> None:
    text = LEG.replace("device: DM4340, gains: {kp: 120.0", ours)
    assert text != LEG
    with pytest.raises(ConfigError) as caught:
        read(tmp_path, text)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("knee", "message"),
    [
        ("{id: 1, limits_rad: [-1, 1]}", "id 1 on bus leg is that of hip already"),
        ("{id: 0, limits_rad: [-1, 1]}", "0 is outside >= 1 and <= 127"),
        ("{id: 128, limits_rad: [-1, 1]}", "128 is outside >= 1 and <= 127"),
        (
            "{id: 17, limits_rad: [-1, 1]}",
            "joints.knee.id: the command id of knee and the feedback id of hip are both 0x11 on bus leg",
        ),
        (
            "{id: 2, feedback_id: 17, limits_rad: [-1, 1]}",
            "joints.knee.feedback_id: the feedback id of knee and the feedback id of hip are both 0x11",
        ),
        (
            "{id: 2, feedback_id: 1, limits_rad: [-1, 1]}",
            "joints.knee.feedback_id: the feedback id of knee and the command id of hip are both 0x1",
        ),
        (
            "{id: 2, feedback_id: 2, limits_rad: [-1, 1]}",
            "feedback_id: 2 is its own command id: give it another",
        ),
        ("{id: 2, feedback_id: 2047, limits_rad: [-1, 1]}", "2047 is outside >= 1 and <= 2046"),
        (
            "{type: ak, id: 2, feedback_id: 9, limits_rad: [-1, 1]}",
            "feedback_id: a AK70-10 has none: remove it",
        ),
        ("{type: ak, id: 17, limits_rad: [-1, 1]}", "the command id of knee and the feedback id of hip"),
        ("{type: od, id: 64, limits_rad: [-1, 1]}", "64 is outside >= 0 and <= 63"),
        (
            "{type: od, id: 0, limits_rad: [-1, 1]}",
            "command 0x01 of knee and the command id of hip are both 0x1",
        ),
        (
            "{type: xm, id: 2, limits_rad: [-1, 1]}",
            "bus: type xm is a XM430-W350, for buses of kind dynamixel2; bus leg is of kind can",
        ),
        (
            "{bus: arm, id: 2, limits_rad: [-1, 1]}",
            "bus: type dm is a DM4340, for buses of kind can; bus arm is of kind dynamixel2",
        ),
        ("{id: 2, limits_rad: [-1, 1], registers: {shutdown: 52}}", "joints.knee.registers: unknown key"),
        ("{id: 2, mode: position, limits_rad: [-1, 1]}", "'position' is none of impedance"),
        ("{id: 2, ratio: 3.0, limits_rad: [-1.2, 1.2]}", "more than 1 in mode impedance"),
    ],
)
def test_an_invalid_can_joint_is_refused(tmp_path: Path, knee: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        read(tmp_path, LEG.replace(KNEE, f"  knee: {knee}\n"))
    assert message in str(caught.value)


def test_families_with_29_bit_ids_conflict_with_none_and_others_by_their_frames(tmp_path: Path) -> None:
    more = "  ankle: {type: rs, id: 17, limits_rad: [-1, 1]}\n  toe: {type: od, id: 3, limits_rad: [-1, 1]}\n"
    robot = read(tmp_path, LEG.replace("poses:", f"{more}poses:"))
    assert [joint.feedback_id for joint in robot.joints[3:]] == [None, None]


@pytest.mark.parametrize(
    ("bus", "message"),
    [
        ("{kind: can, bitrate: 1500000}", "buses.leg.bitrate: 1500000 is none of 125000, 250000, 500000"),
        ("{kind: can, baud: 1000000}", "buses.leg.baud: unknown key"),
        (
            "{kind: can, port: /dev/ttyACM0}",
            "buses.leg.port: /dev/ttyACM0: a bus of kind can needs can:INTERFA",
        ),
        ("{kind: can, port: 'can:can0'}", "can:can0: a CAN port is can:INTERFACE:CHANNEL"),
        ("{kind: canopen}", "'canopen' is none of can, dynamixel1"),
    ],
)
def test_an_invalid_can_bus_is_refused(tmp_path: Path, bus: str, message: str) -> None:
    old = '{kind: can, bitrate: 1000000, port: "can:slcan:/dev/ttyACM0"}'
    with pytest.raises(ConfigError) as caught:
        read(tmp_path, LEG.replace(old, bus))
    assert message in str(caught.value)


def test_a_serial_bus_takes_no_can_port(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="a bus of kind dynamixel2 needs the path of a serial port"):
        read(tmp_path, LEG.replace("{kind: dynamixel2}", "{kind: dynamixel2, port: 'can:socketcan:can0'}"))


def test_every_model_of_the_drivers_can_stand_in_a_robot_file(tmp_path: Path) -> None:
    for device in MODELS:
        extra = "ranges: {position_rad: 12.5}, watchdog: unverified"
        text = LEG.replace(
            "{device: DM4340, gains: {kp: 120.0", f"{{device: {device}, {extra}, gains: {{kp: 120.0"
        )
        text = text.replace("velocity_limit_rad_s: 4.0", "velocity_limit_rad_s: 2.0").replace(
            " feedback_id: 0x22,", ""
        )
        robot = read(tmp_path, text)
        assert kind(robot).device == device, device
        assert kind(robot).family == MODELS[device].family, device


def test_heat_is_judged_below_what_the_vendor_advises_and_else_not_at_all(tmp_path: Path) -> None:
    robot = read(tmp_path, LEG)
    heat = kind(robot).heat
    assert (heat.warn, heat.slow, heat.settle, heat.cool) == (80.0, 85.0, 90.0, 75.0)
    unknown = read(tmp_path, LEG.replace(KNEE, "  knee: {type: rs, id: 2, limits_rad: [-1, 1]}\n"))
    assert kind(unknown, 1).heat.settle == float("inf")
    assert kind(robot).supply.fault == float("-inf")


def test_the_mixed_robot_is_the_body_of_h24_with_legs_on_can() -> None:
    mixed = load_robot("h24-mixed")
    plain = load_robot("h24")
    assert [(bus.name, bus.kind) for bus in mixed.buses] == [
        ("upper", "dynamixel2"),
        ("l_leg", "can"),
        ("r_leg", "can"),
    ]
    assert (mixed.mjcf, mixed.poses, mixed.gate) == (plain.mjcf, plain.poses, plain.gate)
    same = [(j.name, j.sign, j.ratio, j.lower, j.upper) for j in mixed.joints]
    assert same == [(j.name, j.sign, j.ratio, j.lower, j.upper) for j in plain.joints]
    for bus in ("l_leg", "r_leg"):
        legs = [joint for joint in mixed.joints if joint.bus == bus]
        assert [joint.id for joint in legs] == [1, 2, 3, 4, 5, 6]
        assert {joint.name[:2] for joint in legs} == {bus[:2]}
        assert all(isinstance(joint.type, CanType) for joint in legs)
    assert sum(joint.bus == "upper" for joint in mixed.joints) == 12


@pytest.mark.parametrize("name", ["DM4340", "AK70-10", "RS01", "ODrive"])
def test_watchdog_and_supply_settings_match_the_codec(name: str) -> None:
    spans = ranges_of([replace(MODELS[name], position=12.5)])
    family = make(MODELS[name].family, "leg", [1], [name], ranges=spans, feedback_ids=[17])
    assert (family.watchdog is None) == (family.name in MUTE)
    reads = {parameter for parameter in family.parameters if parameter == "bus_voltage"}
    assert bool(reads) == (family.name in TELL_VOLTAGE)


def test_an_odrive_reports_no_torque_so_its_effort_is_unknown_and_never_zero(tmp_path: Path) -> None:
    robot = read(
        tmp_path, LEG.replace("defaults: {type: dm", "defaults: {type: od").replace(", feedback_id: 0x22", "")
    )
    odrive = kind(robot)
    assert odrive.family == "odrive"
    assert isnan(odrive.effort_lsb_nm)
    assert isnan(odrive.full_effort)
    assert odrive.effort_limit_nm == odrive.torque_limit_nm


def test_an_odrive_without_damping_is_refused_where_it_is_written(tmp_path: Path) -> None:
    """Its stiffness works through its damping; else arming and damping would fail, not the file."""
    line = "  od: {device: ODrive, gains: {kp: 50.0, kd: 1.0}"
    with pytest.raises(ConfigError, match=r"types\.od\.gains\.kd: .*works through its damping"):
        read(tmp_path, LEG.replace(line, line.replace("kd: 1.0", "kd: 0.0")))


def test_the_gains_of_a_can_actuator_are_its_stiffness_and_lag(tmp_path: Path) -> None:
    found = kind(read(tmp_path, LEG))
    assert (found.stiffness_nm_per_rad, found.lag_s) == (120.0, 3.0 / 120.0)
    assert isnan(found.with_gains({"kp": 0.0, "kd": 1.0}).lag_s)
