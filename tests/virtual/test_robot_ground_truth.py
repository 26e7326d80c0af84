"""The truth of a virtual robot is read, refused, drawn; servos, body and calibration follow it."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from twind.config.calibration_file import load_calibration
from twind.config.counts import angle_of
from twind.config.robot_file import load_robot
from twind.config.yaml_tree import ConfigError
from twind.exceptions import InvalidInput
from twind.virtual.robot_ground_truth import (
    PLAIN,
    JointGroundTruth,
    RobotGroundTruth,
    load_truth,
    random_truth,
)
from twind.virtual.virtual_robot_spec import VirtualRobotSpec, buses, calibration, make_spec, save
from twind_drivers.virtual.virtual_servos import VirtualServos

H24 = load_robot("h24")
KNEE = H24.joints[H24.names.index("l_knee")]


def made_with(**knee: object) -> VirtualRobotSpec:
    return make_spec(H24, truth=RobotGroundTruth({"l_knee": JointGroundTruth(**knee)}))  # type: ignore[arg-type]


def servo(made: VirtualRobotSpec, joint: str, physics: bool = False) -> tuple[VirtualServos, int]:
    """The servos of the bus of h24, and the row at that joint."""
    servos = buses(made, physics=physics)["main"].servos
    servos.settle(0.0)
    return servos, H24.names.index(joint)


def shows(made: VirtualRobotSpec, joint: str, physics: bool = False) -> int:
    servos, row = servo(made, joint, physics)
    return int(servos.readings.position.get()[row])


# ---------------------------------------------------------------------------------------- the file


def load(tmp_path: Path, text: str) -> RobotGroundTruth:
    (tmp_path / "truth.yaml").write_text(text)
    return load_truth(tmp_path / "truth.yaml", H24)


def test_a_ground_truth_file_gives_the_fields_of_the_dataclass(tmp_path: Path) -> None:
    said = {
        "zero_ticks": 4020,
        "sign": -1,
        "stops_rad": [-0.1, 2.2],
        "friction_nm": 0.08,
        "backlash_ticks": 3,
        "turns": -1,
        "homing_offset": -512,
        "drive_mode": 1,
        "startup_configuration": 1,
        "tag": 613,
        "registers": {"shutdown": 53},
        "firmware": 46,
        "forgets_offset": True,
        "seam_seed": 3,
    }
    found = load(tmp_path, json.dumps({"joints": {"l_knee": said, "r_knee": {"swapped_with": "head_yaw"}}}))
    assert found.joint_truth("l_knee") == JointGroundTruth(**said | {"stops_rad": (-0.1, 2.2)})
    assert set(found.joint_truth("l_knee").non_default_keys()) == set(said)
    assert (found.holder("r_knee"), found.holder("head_yaw")) == ("head_yaw", "r_knee")
    assert found.joint_truth("head_pitch") == PLAIN and found.holder("head_pitch") == "head_pitch"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("joints: {l_kne: {sign: 1}}", "joints.l_kne: unknown key; nearest: l_knee"),
        ("joints: {l_knee: {zero: 1}}", "joints.l_knee.zero: unknown key"),
        ("joints: {l_knee: {sign: 0}}", "0 is none of 1, -1"),
        ("joints: {l_knee: {sign: 2}}", "2 is none of 1, -1"),
        ("joints: {l_knee: {zero_ticks: 1.5}}", "a whole number is expected"),
        ("joints: {l_knee: {friction_nm: -0.1}}", "-0.1 is outside"),
        ("joints: {l_knee: {friction_nm: .nan}}", ".nan is not a finite number"),
        ("joints: {l_knee: {stops_rad: [2.0, 1.0]}}", "2 is not below 1"),
        ("joint: {}", "joint: unknown key"),
    ],
)
def test_a_file_that_is_wrong_is_refused_with_the_place(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(ConfigError) as refused:
        load(tmp_path, text)
    assert words in str(refused.value)


@pytest.mark.parametrize(
    ("joints", "words"),
    [
        ({"l_kne": PLAIN}, "h24 has no joint 'l_kne'"),
        ({"l_knee": JointGroundTruth(swapped_with="l_knee")}, "is no other joint of its bus"),
        ({"l_knee": JointGroundTruth(swapped_with="tail")}, "is no other joint of its bus"),
        (
            {
                "l_knee": JointGroundTruth(swapped_with="r_knee"),
                "r_knee": JointGroundTruth(swapped_with="head_yaw"),
            },
            "swapped with another one",
        ),
        (
            {"l_knee": JointGroundTruth(registers={"present_position": 1})},
            "no EEPROM register 'present_position'",
        ),
        ({"l_knee": JointGroundTruth(registers={"homing": 1})}, "no EEPROM register 'homing'"),
        ({"l_knee": JointGroundTruth(tag=5000)}, "moving_threshold 5000 is outside 0..1023"),
    ],
)
def test_an_impossible_ground_truth_is_refused(joints: dict[str, JointGroundTruth], words: str) -> None:
    with pytest.raises(InvalidInput) as refused:
        make_spec(H24, truth=RobotGroundTruth(joints))
    assert words in str(refused.value)


def test_a_servo_only_ground_truth_is_refused_for_a_can_actuator() -> None:
    mixed = load_robot("h24-mixed")
    make_spec(
        mixed,
        truth=RobotGroundTruth({"l_knee": JointGroundTruth(zero_ticks=100, sign=-1, stops_rad=(-0.1, 2.2))}),
    )
    with pytest.raises(InvalidInput, match="l_knee: a DM4310 has no turns; it has zero_ticks"):
        make_spec(mixed, truth=RobotGroundTruth({"l_knee": JointGroundTruth(turns=1)}))


# ---------------------------------------------------------------------------------------- what follows


def test_an_empty_ground_truth_changes_only_the_stops() -> None:
    plain = make_spec(H24)
    told = make_spec(H24, truth=RobotGroundTruth())
    assert plain.zeros == told.zeros == plain.shown == told.shown
    assert plain.hinge("l_knee").stops == (-math.inf, math.inf)
    assert all(map(math.isfinite, told.hinge("l_knee").stops)), "the model's range"


@examples(25)
@given(
    zero=st.integers(-9000, 9000),
    sign=st.sampled_from([1, -1]),
    offset=st.sampled_from([0, -512, 1024, -1025, 2900]),
    reverse=st.booleans(),
)
def test_shown_is_what_the_register_shows_at_angle_0(
    zero: int, sign: int, offset: int, reverse: bool
) -> None:
    made = made_with(zero_ticks=zero, sign=sign, homing_offset=offset, drive_mode=int(reverse))
    rest = H24.poses["rest"]["l_knee"]
    way = sign * (-1 if reverse else 1)
    travelled = round(rest * way * 4096 / math.tau)
    assert abs(shows(made, "l_knee") - (made.shown["l_knee"] + travelled)) <= 1
    least = offset if abs(offset) <= 1024 else 0
    assert least <= shows(made, "l_knee") < least + 4096, "one turn and the offset, after a boot"


def test_a_turn_offset_changes_the_count_and_not_the_calibration() -> None:
    off = made_with(turns=-2)
    right = made_with()
    assert shows(off, "l_knee") == shows(right, "l_knee") - 2 * 4096
    assert off.shown == right.shown
    assert calibration(off).joints == calibration(right).joints


def test_servos_with_exchanged_ids_sit_where_they_were() -> None:
    made = make_spec(H24, truth=RobotGroundTruth({"l_knee": JointGroundTruth(swapped_with="r_knee")}))
    servos, left = servo(made, "l_knee")
    right = H24.names.index("r_knee")
    ids = servos.registers.ids()
    assert (ids[left], ids[right]) == (H24.joints[right].id, H24.joints[left].id)
    found = calibration(made).by_name
    plain = make_spec(H24)
    assert found["l_knee"].zero_ticks == plain.zeros["r_knee"], "of the servo with its id"
    assert found["l_knee"].id == H24.joints[left].id


def test_registers_and_firmware_follow_the_ground_truth() -> None:
    made = made_with(tag=613, startup_configuration=1, firmware=46, registers={"shutdown": 53})
    servos, row = servo(made, "l_knee")
    memory = servos.memory
    keys = ("moving_threshold", "startup_configuration", "shutdown")
    told = {key: memory.value(row, memory.tables[row][key]) for key in keys}
    assert told == {"moving_threshold": 613, "startup_configuration": 1, "shutdown": 53}
    entry = calibration(made).by_name["l_knee"]
    assert (entry.device.tag, entry.device.firmware) == (613, 46)
    assert servos["torque_enable"][row] == 1, "bit 0 of 60"


def test_the_fitting_calibration_has_the_travel_from_stop_to_stop_and_is_read_back(tmp_path: Path) -> None:
    made = made_with(zero_ticks=4020, stops_rad=(-0.1, 2.2))
    save(made, tmp_path / "one.yaml")
    entry = load_calibration(tmp_path / "one.yaml", H24).by_name["l_knee"]
    ends = sorted(angle_of(KNEE, entry.zero_ticks, ticks) for ticks in entry.sweep_ticks)
    assert ends == pytest.approx([-0.1, 2.2], abs=0.001)
    assert entry.seam_margin_ticks == 0, "it crosses the seam"


def test_a_wrong_sign_is_not_in_the_calibration() -> None:
    """A sweep by hand sees counts, not angles: what it finds has the file's sign, right or wrong."""
    entry = calibration(made_with(sign=-KNEE.sign)).by_name["l_knee"]
    assert entry.sign == KNEE.sign
    low, high = sorted(angle_of(KNEE, entry.zero_ticks, ticks) for ticks in entry.sweep_ticks)
    assert high < 0.2 and low < -1.5, "the knee bends the wrong way"


@pytest.mark.parametrize("sign", [1, -1])
def test_the_wiring_of_the_body_follows_the_ground_truth(sign: int) -> None:
    """The joint stands where it rests whatever counts it, and its encoder counts the way it is wired."""
    made = made_with(sign=sign)
    servos, row = servo(made, "l_knee", physics=True)
    wired = made.wired.joints[row]
    angle = angle_of(wired, made.zeros["l_knee"], round(float(servos.muscles.position[row])))
    assert wired.sign == sign
    assert angle == pytest.approx(H24.poses["rest"]["l_knee"], abs=0.005)


# ---------------------------------------------------------------------------------------- drawn


@pytest.mark.parametrize("name", ["h24", "h24-mixed"])
def test_a_drawn_ground_truth_is_determined_by_its_seed(name: str) -> None:
    robot = load_robot(name)
    assert random_truth(robot, 7) == random_truth(robot, 7) != random_truth(robot, 8)
    assert set(random_truth(robot, 7).joints) == set(robot.names)


@examples(10)
@given(st.integers(0, 10_000))
def test_every_drawn_virtual_robot_is_usable_with_its_calibration(seed: int) -> None:
    made = make_spec(H24, truth=random_truth(H24, seed))
    for entry, joint in zip(calibration(made).joints, H24.joints, strict=True):
        low, high = entry.sweep_ticks
        assert 0 <= low < high <= 4095, "position mode goes to one turn alone"
        ends = sorted(angle_of(joint, entry.zero_ticks, ticks) for ticks in (low, high))
        assert ends[0] < joint.lower and joint.upper < ends[1], "stops lie outside the limits"


def test_drawn_zeros_are_all_over_the_encoder() -> None:
    zeros = np.array(
        [list(make_spec(H24, truth=random_truth(H24, seed)).zeros.values()) for seed in range(5)]
    )
    assert zeros.min() < 900 and zeros.max() > 3200
