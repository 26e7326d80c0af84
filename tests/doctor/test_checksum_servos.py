"""Findings about Feetech servos and Dynamixels of Protocol 1.0, on a virtual bus in process."""

from pathlib import Path

import pytest

from tests.support.checksum_bench import ChecksumBench, Spec, dynamixel1, feetech, robot_of
from twind.config.robot_file import read_robot
from twind.config.robot_spec import RobotFile
from twind.doctor import runner
from twind.doctor.check import DoctorFinding, Severity
from twind.doctor.check_context import CheckContext
from twind.doctor.host_inspector import HostInspector
from twind_drivers.servo_tools.doctor.servo_doctor import DOCTOR

ARM = {"elbow": 2, "wrist": 7}


@pytest.fixture
def so101(tmp_path: Path) -> RobotFile:
    return robot_of(tmp_path, "feetech", "STS3215", ARM)


@pytest.fixture
def darwin(tmp_path: Path) -> RobotFile:
    return robot_of(tmp_path, "dynamixel1", "AX-12A", ARM, more=", return_delay_us: 20")


def context_of(bench: ChecksumBench, robot: RobotFile) -> CheckContext:
    return CheckContext(HostInspector(), "twind.service", robot=robot, lines={"main": bench.inspector()})


def found(bench: ChecksumBench, robot: RobotFile) -> dict[str, DoctorFinding]:
    checks = [each for each in runner.all_checks() if each.what in DOCTOR.at_calibration]
    outcome = runner.run(context_of(bench, robot), checks, runner.table())
    assert outcome.unseen == []
    return {each.code: each for each in outcome.found}


def settled(id: int, **settings: int) -> Spec:
    return dynamixel1(id, return_delay_time=10, **settings)


def test_healthy_servos_cause_no_finding(so101: RobotFile) -> None:
    assert found(ChecksumBench(feetech(2), feetech(7)), so101) == {}


def test_healthy_dynamixels_cause_no_finding(darwin: RobotFile) -> None:
    assert found(ChecksumBench(settled(2), settled(7)), darwin) == {}


@pytest.mark.parametrize(
    ("wrong", "code", "measured"),
    [
        ({"return_delay_time": 250}, "RETURN_DELAY", "return_delay_time (7) is 250"),
        ({"operating_mode": 1}, "OPERATING_MODE", "operating_mode (33) is 1"),
        ({"status_return_level": 0}, "STATUS_LEVEL", "status_return_level (8) is 0"),
        ({"shutdown": 4}, "SHUTDOWN_MASK", "shutdown (19) is 4"),
        ({"phase": 28}, "REGISTER_DIFFERS", "phase (18) is 28"),
        ({"max_voltage_limit": 60}, "SERVO_ERROR", "hardware error (65) is 1: supply voltage"),
        ({"min_position_limit": 3000}, "FENCE_TIGHT", "position limits are 3000..4095"),
    ],
)
def test_each_wrong_register_of_a_feetech_servo_is_found(
    so101: RobotFile, wrong: dict[str, int], code: str, measured: str
) -> None:
    one = found(ChecksumBench(feetech(2), feetech(7, **wrong)), so101)
    assert one[code].measured == measured
    assert one.keys() <= {code, "VOLTAGE_HIGH"}


@pytest.mark.parametrize(
    ("wrong", "code", "measured"),
    [
        ({"return_delay_time": 250}, "RETURN_DELAY", "return_delay_time (5) is 250"),
        ({"max_position_limit": 0}, "OPERATING_MODE", "max_position_limit (8) is 0"),
        ({"shutdown": 4}, "SHUTDOWN_MASK", "shutdown (18) is 4"),
        ({"max_torque": 0}, "REGISTER_DIFFERS", "max_torque (14) is 0"),
        ({"temperature_limit": 20}, "SERVO_ERROR", "error byte is 4: overheating"),
    ],
)
def test_each_wrong_register_of_a_dynamixel_is_found(
    darwin: RobotFile, wrong: dict[str, int], code: str, measured: str
) -> None:
    one = found(ChecksumBench(settled(2), dynamixel1(7, **({"return_delay_time": 10} | wrong))), darwin)
    assert one[code].measured == measured
    assert one.keys() == {code}


def test_a_locked_dynamixel_is_a_note_with_the_remedy(darwin: RobotFile) -> None:
    bench = ChecksumBench(settled(2), settled(7))
    bench.bus.servos.put(1, "lock", 1)
    (one,) = found(bench, darwin).values()
    assert (one.code, one.severity) == ("REGISTER_DIFFERS", Severity.NOTE)
    assert "switch its supply off and on" in one.advice


def test_a_new_servo_is_found_with_the_command_that_adopts_it(so101: RobotFile) -> None:
    same = found(ChecksumBench(feetech(2), feetech(1)), so101)
    assert same.keys() == {"SERVO_MISSING", "SERVO_FOREIGN"}
    assert same["SERVO_FOREIGN"].command == "twindctl adopt wrist"
    other = found(ChecksumBench(feetech(2), feetech(1, baud_rate=4)), so101)
    assert other["BAUD_WRONG"].command == "twindctl adopt wrist"
    assert other["BAUD_WRONG"].thing.endswith("id 1 at 115200 baud")


def test_two_servos_with_one_id_and_a_wrong_model_are_found(so101: RobotFile) -> None:
    one = found(ChecksumBench(feetech(2, "STS3250"), feetech(7), feetech(7)), so101)
    assert one.keys() == {"SERVO_MODEL", "ID_TWICE"}


def test_a_fix_on_the_free_port_opens_the_lock_and_closes_it(so101: RobotFile) -> None:
    bench = ChecksumBench(feetech(2), feetech(7, return_delay_time=250))
    fix = found(bench, so101)["RETURN_DELAY"].fix
    assert fix is not None
    line = bench.inspector()
    bench.inspector = lambda: line  # type: ignore[method-assign]
    line.close = lambda: None  # type: ignore[method-assign]
    fix = found(bench, so101)["RETURN_DELAY"].fix
    assert fix is not None
    fix.do()
    assert (bench.value(1, "return_delay_time"), bench.value(1, "lock")) == (0, 1)
    assert bench.bus.servos.eprom[1][7] == 0  # type: ignore[union-attr]
    assert found(bench, so101) == {}


def test_what_arming_refuses_for_another_reason_is_found(so101: RobotFile, tmp_path: Path) -> None:
    path = tmp_path / "bench.yaml"
    path.write_text(path.read_text().replace(", watchdog: none", ""))
    (one,) = found(ChecksumBench(feetech(2), feetech(7)), read_robot(path)).values()
    assert one.code == "REGISTER_DIFFERS"
    assert "watchdog: none" in one.measured
