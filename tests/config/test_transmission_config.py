"""Actuators and transmissions of a robot file: who turns whom, and what is refused by name."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.support import transmission_robot_file as linked
from tests.support.slot_poses import joint_angles
from twind.config.counts import slot_angles
from twind.config.robot_file import read_robot
from twind.config.robot_report import check_robot
from twind.config.robot_spec import RobotFile
from twind.config.yaml_tree import ConfigError
from twind.robot.linkage_table import LinkageTable


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> RobotFile:
    return linked.linked(tmp_path_factory.mktemp("linked"))


def test_a_joint_of_a_transmission_sits_on_its_actuator(robot: RobotFile) -> None:
    seats = {
        joint.name: (joint.actuator, joint.bus, joint.id, joint.sign, joint.ratio) for joint in robot.joints
    }
    assert seats == {
        "waist_roll": ("waist_a", "main", 3, -1, 1.0),
        "knee": ("knee", "main", 2, 1, 1.0),
        "ankle_roll": ("ank_out", "leg", 6, -1, 1.0),
        "waist_yaw": ("waist_b", "main", 1, 1, 1.2),
        "ankle_pitch": ("ank_in", "leg", 5, 1, 1.0),
    }
    assert [joint.transmission for joint in robot.joints] == ["waist", "", "ankle", "waist", "ankle"]
    assert (robot.joints[0].lower, robot.joints[0].upper) == (-0.4, 0.4)  # limits stay the joint's


def test_joints_of_a_differential_get_what_both_actuators_can_at_once(robot: RobotFile) -> None:
    by_name = {joint.name: joint for joint in robot.joints}
    roll = by_name["waist_roll"]
    yaw = by_name["waist_yaw"]
    for fast in (roll.velocity_limit, -roll.velocity_limit):
        speeds = np.linalg.solve([[-0.25, 0.25], [0.3, 0.3]], [fast, yaw.velocity_limit])
        assert abs(speeds[0]) <= 4.0 + 1e-9
        assert abs(speeds[1]) <= 4.0 / 1.2 + 1e-9
    assert by_name["knee"].velocity_limit == 4.0


def test_the_span_of_an_actuator_is_where_its_joints_take_it(robot: RobotFile) -> None:
    roll = robot.joints[0]
    assert roll.span == pytest.approx((-1.6 - 0.5 / 0.6, 1.6 + 0.5 / 0.6), abs=1.0)
    assert roll.span == pytest.approx((-(0.4 / 0.5 + 0.5 / 0.6), 0.4 / 0.5 + 0.5 / 0.6))
    assert robot.joints[1].span == (0.0, 2.0)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(shares=st.lists(st.floats(0.0, 1.0), min_size=5, max_size=5))
def test_a_pose_is_found_again_from_its_actuators(robot: RobotFile, shares: list[float]) -> None:
    pose = {j.name: j.lower + s * (j.upper - j.lower) for j, s in zip(robot.joints, shares, strict=True)}
    slots = slot_angles(robot, pose)
    for joint in robot.joints:
        assert joint.span[0] - 1e-3 <= slots[joint.name] <= joint.span[1] + 1e-3
    assert joint_angles(robot, slots) == pytest.approx(pose, abs=1e-9)


def test_the_table_is_the_ankle_it_was_made_from(robot: RobotFile) -> None:
    law = robot.transmissions[1].law
    assert isinstance(law, LinkageTable)
    places = np.random.default_rng(1).uniform(-1.0, 1.0, (50, 2))
    for place in places:
        assert law.forward(place) == pytest.approx(linked.ankle(*place), abs=5e-3)


def test_the_order_of_lines_and_columns_of_a_table_is_free(robot: RobotFile, tmp_path: Path) -> None:
    head, *rows = linked.table().splitlines()
    turned = [",".join(row.split(",")[::-1]) for row in (head, *sorted(rows, reverse=True))]
    assert linked.linked(tmp_path, rods="\n".join(turned)).transmissions[1].law == robot.transmissions[1].law


def test_a_calibration_is_bound_to_matrix_and_table(robot: RobotFile, tmp_path: Path) -> None:
    other = linked.linked(tmp_path, linked.ROBOT.replace("[0.3, 0.3]", "[0.3, 0.31]"))
    assert other.description_sha256 != robot.description_sha256
    bent = linked.linked(tmp_path, rods=linked.table(13))
    assert bent.description_sha256 != robot.description_sha256
    assert replace(robot, transmissions=()).description_sha256 != robot.description_sha256


def test_check_robot_prints_condition_numbers_and_worked_examples(robot: RobotFile) -> None:
    report = check_robot(robot)
    text = "\n".join(report.lines)
    assert report.errors == ()
    assert "transmission waist: differential on bus main" in text
    assert "condition 1.2" in text
    assert "table of 15 x 15 places" in text
    row = next(line for line in report.lines if line.strip().startswith("waist_roll 0.4 rad"))
    a, b = (int(part.split()[-1]) for part in row.split(": ")[1].split(", "))
    tick = 2.0 * math.pi / 4096
    assert a == 2048 + round(0.8 / tick)  # sign -1, and the matrix' -1/4
    assert b == 2048 + round(0.8 * 1.2 / tick)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("waist_a: {id: 3", "knee: {id: 3", "actuators.knee: is the name of a joint too"),
        ("waist_a: {id: 3", "waist a: {id: 3", "use 1 to 64 letters"),
        (
            "waist_a: {id: 3, sign: -1}",
            "waist_a: {sign: -1}",
            "actuators.waist_a.id: is required and missing",
        ),
        ("id: 3, sign: -1", "id: 3, sign: 2", "actuators.waist_a.sign: 2 is none of 1, -1"),
        ("ratio: 1.2", "ratio: 0", "actuators.waist_b.ratio: 0 is outside > 0"),
        ("ratio: 1.2", "ration: 1.2", "actuators.waist_b.ration: unknown key; nearest: ratio"),
        ("ratio: 1.2", "limits_rad: [0, 1]", "actuators.waist_b.limits_rad: unknown key"),
        ("waist_b: {id: 1", "waist_b: {id: 2", "id 2 on bus main is that of waist_b already"),
        ("waist_b: {id: 1", "waist_b: {id: 3", "id 3 on bus main is that of waist_a already"),
        ("ank_in: {bus: leg", "ank_in: {bus: lag", "'lag' is none of main, leg; nearest: leg"),
        ("  ank_in: {", "  idle: {id: 9}\n  ank_in: {", "actuators.idle: stands in no transmission"),
        ("kind: differential", "kind: diferential", "nearest: differential"),
        ("kind: differential", "kinds: differential", "waist.kinds: unknown key; nearest: kind"),
        ("[waist_a, waist_b]", "[waist_a, waist_c]", "no actuator 'waist_c'; nearest: waist_"),
        ("[waist_a, waist_b]", "[waist_a, waist_a]", "a name stands there twice"),
        ("[waist_a, waist_b]", "[waist_a]", "1 actuators for 2 joints: as many are needed"),
        ("[waist_a, waist_b]", "[]", "waist.actuators: is required and missing"),
        ("[waist_a, waist_b]", "[waist_a, ank_in]", "waist_a on main, ank_in on leg: all of a transmission"),
        ("waist_roll: [-0.25", "waist_rol: [-0.25", "no joint 'waist_rol'; nearest: waist_roll"),
        (
            "waist_roll: [-0.25, 0.25]",
            "knee: [-0.25, 0.25]",
            "joints.waist_roll.id: is required and missing",
        ),
        ("[0.3, 0.3]", "[0.3]", "waist_yaw: needs 2 numbers, found 1"),
        ("[0.3, 0.3]", "[0.3, a]", "waist_yaw"),
        ("[0.3, 0.3]", "[-0.3, 0.3]", "no inverse: the joints do not move independently"),
        ("[0.3, 0.3]", "[-0.3, 0.301]", "nearly singular: condition number"),
        ("waist:\n    kind", "waist:\n    table: a.csv\n    kind", "waist.table: unknown key"),
        ("table: ankle.csv", "table: ankel.csv", "ankel.csv: cannot be read"),
        ("table: ankle.csv", "matrix: ankle.csv", "ankle.matrix: unknown key; known: kind"),
        (",\n          table: ankle.csv", "", "ankle.table: is required and missing"),
        ("[ankle_pitch, ankle_roll]", "[ankle_pitch, waist_roll]", "waist_roll stands in transmission waist"),
        ("[ank_in, ank_out]", "[ank_in, waist_a]", "waist_a stands in transmission waist already"),
        (
            "waist_roll: {limits",
            "waist_roll: {id: 8, limits",
            "id stands with its actuator waist_a; remove it",
        ),
        ("waist_roll: {limits", "waist_roll: {ratio: 2, limits", "ratio stands with its actuator waist_a"),
        ("waist_roll: {limits", "waist_roll: {stop_rad: {lower: -0.5}, limits", "drives it alone to a stop"),
        ("waist_roll: {limits", "waist_roll: {model_joint: knee, limits", "model joint knee is driven by"),
        (
            "ankle_pitch: {limits_rad: [-0.4",
            "ankle_pitch: {limits_rad: [-1.4",
            "table of transmission ankle ends",
        ),
        (
            "waist_yaw: {limits_rad: [-0.5, 0.5]",
            "waist_yaw: {limits_rad: [-1.7, 1.7]",
            "turns of actuator waist_",
        ),
        ("  knee: {id: 2, ", "  knee: {", "joints.knee.id: is required and missing"),
    ],
)
def test_an_invalid_value_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in linked.ROBOT
    with pytest.raises(ConfigError) as caught:
        linked.linked(tmp_path, linked.ROBOT.replace(old, new, 1))
    assert message in str(caught.value)


@pytest.mark.parametrize("key", ["bus: main", "type: xm", "sign: -1", "mode: position", "registers: {}"])
def test_a_joint_of_a_transmission_has_nothing_of_an_actuator(tmp_path: Path, key: str) -> None:
    with pytest.raises(ConfigError, match="stands with its actuator"):
        linked.linked(tmp_path, linked.ROBOT.replace("ankle_roll: {", f"ankle_roll: {{{key}, "))


def rods(**changes: str) -> str:
    """The table with lines replaced: `l3="..."`."""
    lines = linked.table(5).splitlines()
    for name, text in changes.items():
        lines[int(name[1:]) - 1] = text
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the columns are none; needed: ank_in_rad, ank_out_rad, ankle_pitch_rad, ankle_roll_rad"),
        (linked.HEAD, "has 0 places: 2 to 4096"),
        (rods(l1=linked.HEAD.replace("_rad", "_deg")), ":1:1: the columns are ank_in_deg"),
        (rods(l1=linked.HEAD.replace("ank_in", "ank_out")), "needed: ank_in_rad"),
        (rods(l3="0.1,0.2,0.3"), ":3:1: has 3 numbers, the first line names 4"),
        (rods(l3="0.1,0.2,x,0.3"), ":3:1: ankle_pitch_rad: 'x' is no finite number"),
        (rods(l3="0.1,0.2,nan,0.3"), "'nan' is no finite number"),
        (rods(l3="0.1,inf,0.1,0.3"), "'inf' is no finite number"),
        (rods(l3=rods().splitlines()[1]), "one place of the actuators stands there twice"),
        (rods(l3="0.1,0.2,0.3,0.4"), "are no rectangular grid of"),
        ("\n".join(linked.table(5).splitlines()[:-1]), "24 places are no rectangular grid of 5 x 5"),
        ("\n".join(linked.table(5).splitlines()[:6]), "two places at least"),
        (linked.table(9, reach=2.2), "cannot be inverted: the linkage turns back near ank_in"),
        (linked.table(65), "has 4225 places: 2 to 4096"),
        ('a,"b', "is no CSV file"),
    ],
)
def test_a_table_that_cannot_be_used_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        linked.linked(tmp_path, rods=text)
    assert "ankle.csv" in str(caught.value)
    assert message in str(caught.value)


def test_a_table_that_winds_onto_itself_is_refused(tmp_path: Path) -> None:
    """One sign of det J everywhere, and still two places of the actuators for one of the joints."""
    radii = [0.5, 0.75, 1.0]
    angles = [0.6 * at for at in range(13)]
    rows = [(r, a, 0.4 * r * math.cos(a), 0.4 * r * math.sin(a)) for r in radii for a in angles]
    text = "\n".join([linked.HEAD, *(",".join(map(repr, row)) for row in rows)])
    with pytest.raises(ConfigError, match="places of the actuators give"):
        linked.linked(tmp_path, rods=text)


def test_a_table_that_is_no_file_is_refused(tmp_path: Path) -> None:
    path = linked.write(tmp_path)
    (tmp_path / "ankle.csv").unlink()
    (tmp_path / "ankle.csv").mkdir()
    with pytest.raises(ConfigError, match="is a folder, not a file"):
        read_robot(path)
    (tmp_path / "ankle.csv").rmdir()
    (tmp_path / "ankle.csv").write_bytes(b"\xff\xfe")
    with pytest.raises(ConfigError, match="is no CSV file"):
        read_robot(path)
