"""`twindctl adopt` of Feetech servos and Dynamixels of Protocol 1.0. In process."""

from math import inf
from pathlib import Path

import pytest

from tests.support.checksum_bench import (
    MILLION,
    ChecksumBench,
    Killed,
    Spec,
    dynamixel1,
    feetech,
    robot_of,
)
from twind.command_line.verb import Rejected
from twind.config.robot_spec import RobotFile
from twind_calibration.calibrating.calibration_draft import CalibrationDraft
from twind_drivers.servo_tools.adoption.adoption_steps import AdoptionPlan, prepare
from twind_drivers.servo_tools.adoption.calibration_entry_status import CalibrationEntryStatus
from twind_drivers.servo_tools.adoption.candidate_locations import choose, look

ARM = {"elbow": 2, "wrist": 7}
LOCK = 55


def planned(bench: ChecksumBench, robot: RobotFile, name: str | None = None) -> AdoptionPlan | None:
    bus = robot.buses[0]
    chosen = choose(robot, {bus.name: look(bench.at, robot, bus)}, name)
    if chosen is None:
        return None
    entry = CalibrationEntryStatus(robot, Path("bench.yaml"), None, CalibrationDraft(), chosen.joint.name)
    return prepare(chosen, bench.at, entry)


def adopted(bench: ChecksumBench, robot: RobotFile, name: str | None = None) -> AdoptionPlan:
    plan = planned(bench, robot, name)
    assert plan is not None
    plan.carry_out()
    assert planned(bench, robot) is None
    again = planned(bench, robot, "wrist")
    assert again is not None and again.nothing
    return plan


def test_a_feetech_servo_as_delivered_becomes_the_missing_joint_with_its_lock_closed(tmp_path: Path) -> None:
    robot = robot_of(tmp_path, "feetech", "STS3215", ARM)
    fresh = feetech(1, return_delay_time=250, phase=28, shutdown=0, min_position_limit=500, homing_offset=-9)
    bench = ChecksumBench(feetech(2), fresh)
    plan = adopted(bench, robot)
    assert (plan.chosen.place.id, plan.chosen.home.id) == (1, 7)
    names = ("id", "return_delay_time", "phase", "shutdown", "min_position_limit", "homing_offset", "lock")
    assert [bench.value(1, name) for name in names] == [7, 0, 12, 36, 0, 0, 1]
    assert [bench.value(1, name) for name in ("torque_enable", "position_p_gain")] == [0, 32]
    stored = bench.bus.servos.eprom[1]  # type: ignore[union-attr]
    assert (stored[5], stored[7]) == (7, 0)  # it survives power-off
    assert bench.port.writes[0] == (1, LOCK) and bench.port.writes[-1] == (7, LOCK)
    assert {id for id, _ in bench.port.writes} == {1, 7}


def test_a_feetech_servo_at_another_rate_gets_the_rate_of_the_bus_last(tmp_path: Path) -> None:
    robot = robot_of(tmp_path, "feetech", "STS3215", ARM)
    bench = ChecksumBench(feetech(2), feetech(1, baud_rate=4))
    adopted(bench, robot)
    assert (bench.value(1, "id"), bench.bus.servos.baud(1), bench.value(1, "lock")) == (7, MILLION, 1)


def test_a_rate_whose_code_is_not_certain_is_never_written(tmp_path: Path) -> None:
    robot = robot_of(tmp_path, "feetech", "STS3215", {"wrist": 7}, baud=57_600)
    bench = ChecksumBench(feetech(1))
    with pytest.raises(Rejected, match="sources differ on how these servos are set to 57600 baud"):
        adopted(bench, robot)
    assert (bench.bus.servos.baud(0), bench.value(0, "lock")) == (MILLION, 1)


def test_a_servo_of_many_turns_gets_both_limits_zero(tmp_path: Path) -> None:
    robot = robot_of(tmp_path, "feetech", "STS3215", ARM, joint=", mode: extended_position")
    turns = {"phase": 28, "max_position_limit": 0}
    bench = ChecksumBench(feetech(2, **turns), feetech(1))
    adopted(bench, robot)
    assert [bench.value(1, name) for name in ("min_position_limit", "max_position_limit", "phase")] == [
        0,
        0,
        28,
    ]


def test_big_endian_servos_are_adopted_alike(tmp_path: Path) -> None:
    robot = robot_of(tmp_path, "feetech", "SCS0009", ARM)
    bench = ChecksumBench(feetech(2, "SCS0009"), feetech(1, "SCS0009", max_position_limit=700))
    adopted(bench, robot)
    names = ("id", "max_position_limit", "lock")
    assert [bench.value(1, name) for name in names] == [7, 1023, 1]


def test_a_dynamixel_of_protocol_1_becomes_the_missing_joint(tmp_path: Path) -> None:
    robot = robot_of(tmp_path, "dynamixel1", "MX-28(1.0)", ARM, more=", return_delay_us: 20")
    settled = dynamixel1(2, "MX-28(1.0)", return_delay_time=10)
    fresh = dynamixel1(
        1, "MX-28(1.0)", baud_rate=34, max_torque=0, max_position_limit=0, shutdown=0, resolution_divider=2
    )
    bench = ChecksumBench(settled, fresh)
    plan = adopted(bench, robot)
    assert (plan.chosen.place.baud, plan.chosen.home.baud) == (57_600, MILLION)
    names = ("id", "baud_rate", "return_delay_time", "max_torque", "max_position_limit", "shutdown")
    assert [bench.value(1, name) for name in names] == [7, 1, 10, 1023, 4095, 36]
    assert (bench.value(1, "resolution_divider"), bench.value(1, "torque_enable")) == (1, 0)


def test_a_locked_dynamixel_is_refused_with_the_remedy(tmp_path: Path) -> None:
    robot = robot_of(tmp_path, "dynamixel1", "AX-12A", ARM)
    bench = ChecksumBench(dynamixel1(2), dynamixel1(1))
    bench.bus.servos.put(1, "lock", 1)
    with pytest.raises(Rejected, match=r"locked .lock, 47.: take its power away"):
        planned(bench, robot)
    assert bench.port.writes == []


@pytest.mark.parametrize(
    ("specs", "name", "message"),
    [
        ([feetech(2), feetech(1), feetech(1)], None, "two devices"),
        ([feetech(2), feetech(1, "STS3250")], None, "is STS3250; wrist needs STS3215"),
        ([feetech(2), feetech(1, max_voltage_limit=60)], None, r"error is 0x01 .supply voltage."),
        ([feetech(2)], None, "id 1 at 115200 baud or id 1 at 500000 baud or .* no new one answers"),
    ],
)
def test_what_is_no_single_new_servo_is_refused(
    tmp_path: Path, specs: list[Spec], name: str | None, message: str
) -> None:
    bench = ChecksumBench(*specs)
    with pytest.raises(Rejected, match=message):
        planned(bench, robot_of(tmp_path, "feetech", "STS3215", ARM), name)
    assert bench.port.writes == []


def test_a_new_servo_with_the_id_of_another_joint_is_adopted_when_it_is_alone_and_named(
    tmp_path: Path,
) -> None:
    """Six servos of an SO-101 have ids 1 to 6, and a new one has id 1, at the same rate."""
    robot = robot_of(tmp_path, "feetech", "STS3215", {"pan": 1, "wrist": 7})
    with pytest.raises(Rejected, match=r"pan's: .*alone on the port `twindctl adopt wrist` does the rest"):
        planned(ChecksumBench(feetech(1)), robot)
    bench = ChecksumBench(feetech(1))
    plan = planned(bench, robot, "wrist")
    assert plan is not None and plan.chosen.home.id == 7
    plan.carry_out()
    assert (bench.value(0, "id"), bench.value(0, "lock")) == (7, 1)


@pytest.mark.parametrize("kind", ["feetech", "dynamixel1"])
def test_an_adoption_that_died_at_any_write_is_completed_by_the_same_command(
    tmp_path: Path, kind: str
) -> None:
    """Without the lock, which a dead program cannot close."""
    feet = kind == "feetech"
    robot = robot_of(tmp_path, kind, "STS3215" if feet else "AX-12A", ARM)
    for count in range(20):
        changed = {"baud_rate": 4} if feet else {"baud_rate": 34, "shutdown": 0}
        fresh = feetech(1, return_delay_time=250, **changed) if feet else dynamixel1(1, **changed)
        bench = ChecksumBench(feetech(2) if feet else dynamixel1(2), fresh)
        plan = planned(bench, robot)
        assert plan is not None
        bench.port.left = count
        try:
            plan.carry_out()
        except Killed:
            bench.port.left = inf
            rest = planned(bench, robot, "wrist")
            assert rest is not None
            rest.carry_out()
        names = ("id", "shutdown", "torque_enable", "lock")
        assert [bench.value(1, name) for name in names] == [7, 44 if feet else 36, 0, int(feet)]
        assert bench.bus.servos.baud(1) == MILLION
        if bench.port.left != inf:
            return
    pytest.fail("more writes than the test allows")


def test_the_limits_and_offset_of_a_servo_at_its_place_stay(tmp_path: Path) -> None:
    """They may be the calibration of another program, such as LeRobot."""
    robot = robot_of(tmp_path, "feetech", "STS3215", ARM)
    own = {"homing_offset": -300, "min_position_limit": 900, "max_position_limit": 3000}
    bench = ChecksumBench(feetech(2), feetech(7, return_delay_time=250, **own))
    plan = planned(bench, robot, "wrist")
    assert plan is not None
    assert [step.register for step in plan.steps] == ["return_delay_time"]
    plan.carry_out()
    assert {name: bench.value(1, name) for name in own} == own
    assert (bench.value(1, "return_delay_time"), bench.value(1, "lock")) == (0, 1)


def test_a_lock_left_open_by_a_program_that_ended_is_closed(tmp_path: Path) -> None:
    robot = robot_of(tmp_path, "feetech", "STS3215", ARM)
    bench = ChecksumBench(feetech(2), feetech(7))
    bench.bus.servos.put(1, "lock", 0)
    plan = planned(bench, robot, "wrist")
    assert plan is not None and [step.register for step in plan.steps] == ["lock"]
    plan.carry_out()
    assert bench.value(1, "lock") == 1
