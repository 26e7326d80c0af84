"""Survey results of servos, and the doctor's findings about them."""

from twind_calibration.doctor import check_table, robot_checks, runner
from twind_calibration.doctor.check import DoctorFinding
from twind_calibration.doctor.check_context import CheckContext
from twind_calibration.doctor.host_inspector import HostInspector
from twind_calibration.doctor.survey import SerialSurvey, SurveyedServo

from twind.config.calibration_file import Calibration
from twind.config.robot_file import load_robot
from twind.config.robot_spec import JointSpec

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
CHECKS = runner.select_checks(
    check_table.checks(), [code for _, codes, _ in robot_checks.CHECKS for code in codes]
)


def servo(joint: JointSpec, **changed: int | None) -> SurveyedServo:
    """One that is well, but for what is given; None: it could not be read."""
    values = {name: value for name, value in {**WELL, **changed}.items() if value is not None}
    return SurveyedServo("main", joint.id, joint, 1020, "XM430-W350", 47, values, "", 1e-4)


def found(*servos: SurveyedServo, calibration: Calibration | None = None) -> list[DoctorFinding]:
    """What is wrong with a bus where the rest is well."""
    others = {each.id for each in servos}
    rest = [servo(joint) for joint in ROBOT.joints if joint.id not in others]
    survey = SerialSurvey(ROBOT.buses[0], "/dev/ttyUSB0", (*servos, *rest), ())
    seen = CheckContext(
        HostInspector(), "twind.service", robot=ROBOT, calibration=calibration, surveys={"main": survey}
    )
    outcome = runner.run(seen, CHECKS, check_table.complaints())
    assert "CHECK_BROKEN" not in {each.code for each in outcome.found}, outcome.found
    return outcome.found


def codes(*servos: SurveyedServo) -> set[str]:
    return {each.code for each in found(*servos)}


KNEE = next(joint for joint in ROBOT.joints if joint.name == "l_knee")  # -0.1 to 2.2 rad: 1499 counts
