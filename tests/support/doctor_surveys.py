"""Surveys as data: a bus of h24 whose servos are well, except for planted values."""

from twind.config.calibration_file import Calibration
from twind.config.robot_file import load_robot
from twind.config.robot_spec import JointSpec
from twind.ctl.hint_options import HintOptions
from twind.doctor import report, runner
from twind.doctor.check import DoctorFinding
from twind.doctor.check_context import CheckContext
from twind.doctor.host_inspector import HostInspector
from twind.doctor.inspectors import DaemonInspector
from twind_drivers.can.doctor.can_doctor import DOCTOR as CAN_DOCTOR
from twind_drivers.clock import MonotonicClock
from twind_drivers.dynamixel.dynamixel_tools import TOOLS
from twind_drivers.servo_tools.doctor.serial_bus_inspector import SerialBusInspector
from twind_drivers.servo_tools.doctor.serial_bus_survey import SerialBusSurvey, SurveyedServo
from twind_drivers.servo_tools.doctor.servo_doctor import DOCTOR as SERVO_DOCTOR

ROBOT = load_robot("h24")
WELL = {
    "return_delay_time": 5,
    "drive_mode": 0,
    "operating_mode": 3,
    "secondary_shadow_id": 255,
    "homing_offset": 0,
    "max_voltage_limit": 160,
    "min_voltage_limit": 95,
    "pwm_limit": 885,
    "current_limit": 1193,
    "velocity_limit": 200,
    "max_position_limit": 4095,
    "min_position_limit": 0,
    "startup_configuration": 0,
    "shutdown": 52,
    "torque_enable": 0,
    "status_return_level": 2,
    "hardware_error_status": 0,
    "bus_watchdog": 0,
    "profile_velocity": 0,
    "profile_acceleration": 0,
    "present_input_voltage": 120,
    "present_temperature": 30,
}
LINE = SerialBusInspector(
    "/dev/ttyUSB0", 2_000_000, HostInspector(), MonotonicClock(), TOOLS
)  # opened by who uses it, which nobody does
BUS_SUBJECTS = (*SERVO_DOCTOR.at_calibration, *CAN_DOCTOR.at_calibration)
CHECKS = [check for check in runner.all_checks() if check.what in BUS_SUBJECTS]
ROWS = runner.table()
KNEE = next(joint for joint in ROBOT.joints if joint.name == "l_knee")  # -0.1 to 2.2 rad: 1499 counts


def servo(joint: JointSpec, **changed: int | None) -> SurveyedServo:
    """Servo that is well except for `changed`; None: the register could not be read."""
    values = {name: value for name, value in {**WELL, **changed}.items() if value is not None}
    return SurveyedServo("main", joint.id, joint, 1020, "XM430-W350", 47, values, "", 1e-4)


def survey_findings(
    *servos: SurveyedServo,
    calibration: Calibration | None = None,
    daemon: DaemonInspector | None = None,
) -> list[DoctorFinding]:
    """Findings about a bus whose other servos are well."""
    others = {each.id for each in servos}
    rest = [servo(joint) for joint in ROBOT.joints if joint.id not in others]
    survey = SerialBusSurvey(ROBOT.buses[0], "/dev/ttyUSB0", (*servos, *rest), ())
    seen = CheckContext(
        HostInspector(),
        "twind.service",
        daemon=daemon,
        robot=ROBOT,
        calibration=calibration,
        surveys={"main": survey},
    )
    outcome = runner.run(seen, CHECKS, ROWS)
    assert "CHECK_BROKEN" not in {each.code for each in outcome.found}, outcome.found
    return outcome.found


def survey_codes(*servos: SurveyedServo) -> set[str]:
    return {each.code for each in survey_findings(*servos)}


def printed(finding: DoctorFinding) -> str:
    """Text of a finding for a call beside a daemon."""
    ready, fix = report.add_commands([finding], ROWS, HintOptions(), daemon=True)
    return report.text(runner.DoctorReport(found=ready, fix=fix), ROWS, None)


def print_only(code: str, *servos: object, **more: object) -> str:
    """Text of the one finding of this code about a bus whose other servos are well."""
    (finding,) = [each for each in survey_findings(*servos, **more) if each.code == code]  # type: ignore[arg-type]
    return printed(finding)
