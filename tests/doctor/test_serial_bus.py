"""Findings about serial buses, from surveys as data."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from tests.support.daemon_stand_ins import answering
from tests.support.doctor_rig import (
    look,
)
from tests.support.doctor_surveys import (
    CHECKS,
    KNEE,
    ROBOT,
    WELL,
    print_only,
    printed,
    servo,
    survey_codes,
    survey_findings,
)
from twind.client import CallError, Client
from twind.config.robot_file import load_robot
from twind.doctor import runner
from twind.doctor.check import (
    DoctorFinding,
)
from twind.doctor.check_context import CheckContext
from twind.doctor.host_inspector import HostInspector
from twind.doctor.inspectors import DaemonInspector, scan_bus
from twind.exceptions import OperationFailed
from twind_drivers.servo_tools.bus_scan import old_protocol
from twind_drivers.servo_tools.doctor.serial_bus_survey import SerialBusSurvey


def test_healthy_servos_cause_no_finding() -> None:
    assert not survey_findings()


@pytest.mark.parametrize("name", sorted(WELL))
def test_unread_register_causes_no_finding(name: str) -> None:
    assert not survey_codes(servo(KNEE, **{name: None}))


@pytest.mark.parametrize(
    ("register", "well", "ill", "code"),
    [
        ("return_delay_time", 5, 6, "RETURN_DELAY"),  # 10 us in the robot file
        ("homing_offset", 1024, 1025, "OPERATING_MODE"),
        ("homing_offset", -1024, -1025, "OPERATING_MODE"),
        ("secondary_shadow_id", 253, 252, "SECOND_ID"),
        ("present_input_voltage", 112, 111, "VOLTAGE_LOW"),  # told at and below 11.1 V
        ("present_input_voltage", 148, 149, "VOLTAGE_HIGH"),
        ("present_input_voltage", 115, 114, "VOLTAGE_DROP"),  # the others have 12.0 V
        ("present_temperature", 59, 60, "SERVO_ERROR"),
        ("status_return_level", 2, 1, "STATUS_LEVEL"),
        ("drive_mode", 0, 2, "REGISTER_DIFFERS"),  # a slave
        ("velocity_limit", 1, 0, "FENCE_TIGHT"),
        ("pwm_limit", 1, 0, "FENCE_TIGHT"),
        ("current_limit", 1, 0, "FENCE_TIGHT"),
        ("shutdown", 52, 36, "SHUTDOWN_MASK"),
        ("shutdown", 53, 48, "SHUTDOWN_MASK"),
        ("shutdown", 63, 20, "SHUTDOWN_MASK"),
    ],
)
def test_each_bound_separates_finding_from_none(register: str, well: int, ill: int, code: str) -> None:
    assert code not in survey_codes(servo(KNEE, **{register: well}))
    assert code in survey_codes(servo(KNEE, **{register: ill}))


def test_registers_of_another_model_are_not_judged() -> None:
    other = replace(servo(KNEE, present_input_voltage=50, shutdown=0), model=1200, model_name="XL330-M288")
    assert survey_codes(other) == {"SERVO_MODEL"}


def test_old_firmware_is_a_finding_only_without_watchdog_or_where_the_bus_is_too_slow() -> None:
    assert survey_codes(replace(servo(KNEE), firmware=44)) == set()
    assert survey_codes(replace(servo(KNEE), firmware=37)) == {"WATCHDOG_UNKNOWN"}
    slow = replace(servo(KNEE, return_delay_time=250), firmware=44)
    (budget,) = [each for each in survey_findings(slow) if each.code == "BUS_BUDGET"]
    assert f"ids without fast read: {KNEE.id} (firmware 44)" in budget.measured


def test_a_robot_in_sim_has_no_buses_to_look_at(tmp_path: Path) -> None:
    file = tmp_path / "twind.yaml"
    file.write_text("mode: sim\nrobot: h24\n")
    outcome = look("--config", str(file), only=[code for check in CHECKS for code in check.codes])
    assert (outcome.found, outcome.looked, outcome.unseen) == ([], [], [])


def test_bus_without_port_is_unavailable(tmp_path: Path) -> None:
    outcome = look("--robot", "h24", only=["BUS_SILENT"])
    assert not outcome.found
    assert outcome.unseen == [("serial buses", "bus main has no port: name it with --port")]


def test_scan_is_advised_on_the_free_port_or_through_the_daemon(tmp_path: Path) -> None:
    """While a daemon has the port, `scan --port` is refused."""
    spec = ROBOT.buses[0]
    joints = ROBOT.joints
    for servos, code in (((), "BUS_SILENT"), ((servo(joints[1]),), "SERVO_MISSING")):
        survey = SerialBusSurvey(spec, "/dev/ttyUSB0", servos, joints[:1])
        seen = CheckContext(HostInspector(), "twind.service", robot=ROBOT, surveys={"main": survey})
        checks = [check for check in CHECKS if code in check.codes]
        (alone,) = runner.run(seen, checks, runner.table()).found
        assert alone.code == code and "`twindctl scan --port /dev/ttyUSB0` looks for" in alone.advice
        told = {"status": dict.fromkeys(("version", "robot", "mode", "state"), "mirror"), "joints": []}
        with answering(tmp_path) as make:
            make(code, lambda _: {"parameters": told})  # noqa: B023
            seen.daemon = DaemonInspector(Client(tmp_path / f"{code}.sock"))
            (beside,) = runner.run(seen, checks, runner.table()).found
            seen.close()
        assert beside.code == code and "`twindctl scan main`" in beside.advice
        stop = "`sudo systemctl stop twind twind-control.socket twind-observe.socket`"
        assert beside.advice.index(stop) < beside.advice.index("`twindctl scan --port /dev/ttyUSB0`")


def test_servos_of_protocol_1_may_be_those_of_another_bus_whose_port_was_exchanged() -> None:
    arm = load_robot("so101")
    robot = replace(ROBOT, buses=(*ROBOT.buses, replace(arm.buses[0], name="arm")))
    joints = tuple(replace(joint, bus="arm", name=f"arm_{joint.name}") for joint in arm.joints)
    robot = replace(robot, joints=(*ROBOT.joints, *joints))
    for ids, owner in (((1, 2), True), ((1, 40), False)):
        survey = SerialBusSurvey(
            ROBOT.buses[0], "/dev/ttyUSB0", (), ROBOT.joints[:2], troubles=(old_protocol(ids),)
        )
        seen = CheckContext(HostInspector(), "twind.service", robot=robot, surveys={"main": survey})
        checks = [check for check in CHECKS if "BUS_SILENT" in check.codes]
        (found,) = runner.run(seen, checks, runner.table()).found
        assert found.code == "BAUD_WRONG" and f"ids {ids[0]}, {ids[1]}" in found.measured
        assert ("exchange the ports" in found.advice and "bus arm" in found.advice) == owner


@pytest.mark.parametrize("message", ["x", "main: no reply to ping from [1]"])
@pytest.mark.parametrize("silent", [True, False])
def test_scan_of_a_silent_bus_is_empty_by_its_field(message: str, silent: bool) -> None:
    class Deaf(Client):
        def stream(self, method: str, **parameters: object) -> Iterator[Mapping[str, object]]:
            given = {"bus": "main", "message": message, "silent": silent}
            raise CallError("io.twind.Control.BusFailed", given)

    client = Deaf("/nowhere")
    if silent:
        assert scan_bus(client, "main") == {}
    else:
        with pytest.raises(OperationFailed, match="bus main"):
            scan_bus(client, "main")


def test_second_id_warns_about_coupled_servos_first() -> None:
    said = print_only("SECOND_ID", servo(KNEE, secondary_shadow_id=17))
    assert said.index("where two servos turn one joint") < said.index("secondary_shadow_id 255")


def test_silent_bus_warns_about_persons_at_the_robot() -> None:
    for code in ("BUS_SILENT",):
        assert "make sure that no person works at the robot" in printed(
            DoctorFinding(code, "bus main", "no answer")
        )
