"""The doctor's checks of servos over surveys as data: where each bound lies, and what must not be said."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from tests.support.doctor_rig import look
from tests.support.single_answer import answering
from tests.support.surveyed_servos import CHECKS, KNEE, ROBOT, WELL, codes, found, servo
from twind.client import CallError, Client, NoDaemon
from twind.config.actuator_types import CanType
from twind.config.calibration_file import Calibration, JointCalibration
from twind.config.device_record import DeviceRecord
from twind.config.robot_file import load_robot
from twind.ctl.ctl_main import main
from twind_calibration.doctor import (
    check_table,
    daemon_survey,
    register_fix,
    runner,
    service_checks,
)
from twind_calibration.doctor.bus_surveys import merge_findings
from twind_calibration.doctor.check import CheckUnavailable, Devices, DoctorFinding, Fix
from twind_calibration.doctor.check_context import CheckContext
from twind_calibration.doctor.daemon_inspector import DaemonInspector
from twind_calibration.doctor.host_inspector import HostInspector
from twind_calibration.doctor.serial_bus_inspector import SerialBusInspector
from twind_calibration.doctor.survey import SerialSurvey, is_queried
from twind_drivers.clock import MonotonicClock

LINE = SerialBusInspector(
    "/dev/ttyUSB0", 2_000_000, HostInspector(), MonotonicClock()
)  # opened by who uses it, which nobody does


def test_servos_that_are_well_have_no_complaint() -> None:
    assert not found()


@pytest.mark.parametrize("name", sorted(WELL))
def test_a_register_that_could_not_be_read_is_no_complaint_and_breaks_nothing(name: str) -> None:
    assert not codes(servo(KNEE, **{name: None}))


@pytest.mark.parametrize(
    ("register", "well", "ill", "code"),
    [
        ("return_delay_time", 5, 6, "RETURN_DELAY"),  # 10 us in the robot file
        ("homing_offset", 1024, 1025, "OFFSET_IGNORED"),
        ("homing_offset", -1024, -1025, "OFFSET_IGNORED"),
        ("secondary_shadow_id", 253, 252, "SECOND_ID"),
        ("present_input_voltage", 112, 111, "VOLTAGE_LOW"),  # told at and below 11.1 V
        ("present_input_voltage", 148, 149, "VOLTAGE_HIGH"),
        ("present_input_voltage", 115, 114, "VOLTAGE_DROP"),  # the others have 12.0 V
        ("present_temperature", 59, 60, "SERVO_HOT"),
        ("status_return_level", 2, 1, "STATUS_LEVEL"),
        ("velocity_limit", 1, 0, "LIMIT_ZERO"),
        ("pwm_limit", 1, 0, "LIMIT_ZERO"),
        ("current_limit", 1, 0, "LIMIT_ZERO"),
        ("shutdown", 52, 36, "SHUTDOWN_MASK"),
        ("shutdown", 53, 48, "SHUTDOWN_MASK"),
        ("shutdown", 63, 20, "SHUTDOWN_MASK"),
    ],
)
def test_each_bound_is_where_it_is_said_to_be(register: str, well: int, ill: int, code: str) -> None:
    assert code not in codes(servo(KNEE, **{register: well}))
    assert code in codes(servo(KNEE, **{register: ill}))


@pytest.mark.parametrize(
    ("calibrated", "now", "told"),
    [
        ((0, 4095), (1900, 2100), "register write main {0} min_position_limit 0"),
        ((1900, 2100), (1900, 2100), "calibrate l_knee anew, or tighten its `limits_rad`"),
        ((1900, 2100), (1900, 2101), "calibrate l_knee anew, or tighten its `limits_rad`"),
    ],
    ids=["written since", "as calibrated", "written since, and calibrated tight"],
)
def test_what_is_said_of_tight_position_limits_does_not_lead_to_the_next_complaint(
    calibrated: tuple[int, int], now: tuple[int, int], told: str
) -> None:
    record = DeviceRecord(1020, 47, None, 0, 0, 3, *calibrated)
    entry = JointCalibration(
        "l_knee", "main", KNEE.id, record, 2048, 0.0, 1, 1, (0, 4095), 0, (0, 4096), "jig"
    )
    before = Calibration("h24", "", "", "", "jig", (entry,))
    one = servo(KNEE, min_position_limit=now[0], max_position_limit=now[1])
    [tight] = [each for each in found(one, calibration=before) if each.code == "FENCE_TIGHT"]
    assert told.format(KNEE.id) in tight.command + tight.advice
    assert not (tight.command and tight.advice)
    written = dict(line.split()[-2:] for line in tight.command.splitlines())
    after = servo(KNEE, **{name: int(value) for name, value in written.items()})
    if written:
        assert not found(after, calibration=before)


def test_a_mask_that_the_robot_file_demands_is_no_complaint_and_another_is_not_mended_for_anybody() -> None:
    wanted = replace(KNEE, registers={"shutdown": 20})
    assert not codes(servo(wanted, shutdown=20))
    [other] = found(servo(wanted, shutdown=52))
    assert (other.code, other.expected, other.fix) == ("REGISTER_DIFFERS", "20", None)
    [unsaid] = found(servo(KNEE, shutdown=20))
    assert (unsaid.code, unsaid.fix) == ("SHUTDOWN_MASK", None)
    assert "register write main" in unsaid.command


def test_nothing_is_written_that_the_robot_file_demands_otherwise() -> None:
    seen = CheckContext(HostInspector(), "twind.service", robot=ROBOT, lines={"main": LINE})
    assert register_fix.register(seen, servo(KNEE), "return_delay_time", 5) is not None
    demanded = replace(KNEE, registers={"return_delay_time": 9})
    assert register_fix.register(seen, servo(demanded), "return_delay_time", 5) is None
    assert register_fix.register(seen, servo(demanded), "return_delay_time", 9) is not None


def test_without_a_calibration_position_limits_are_judged_by_their_width() -> None:
    assert "FENCE_TIGHT" not in codes(servo(KNEE, min_position_limit=1000, max_position_limit=2500))
    [tight] = found(servo(KNEE, min_position_limit=1000, max_position_limit=2400))
    assert tight.code == "FENCE_TIGHT"
    assert "a width of 14" in tight.expected
    assert not tight.command, "which counts are right, nobody knows"


def test_of_a_servo_of_another_model_its_registers_are_not_judged() -> None:
    other = replace(servo(KNEE, present_input_voltage=50, shutdown=0), model=1200, model_name="XL330-M288")
    assert codes(other) == {"SERVO_MODEL"}


def test_a_servo_that_answers_pings_alone_is_told_as_that_and_nothing_else() -> None:
    assert codes(replace(servo(KNEE), values={})) == {"STATUS_LEVEL"}


def test_several_hardware_errors_are_told_by_name() -> None:
    told = {each.code for each in found(servo(KNEE, hardware_error_status=0b100101))}
    assert told == {"ERROR_VOLTAGE", "ERROR_HEAT", "ERROR_OVERLOAD"}


def test_an_old_servo_among_new_ones_is_a_note_and_one_without_a_watchdog_a_fault() -> None:
    assert codes(replace(servo(KNEE), firmware=44)) == {"FIRMWARE_SLOW"}
    assert codes(replace(servo(KNEE), firmware=37)) == {"FIRMWARE_SLOW", "WATCHDOG_UNKNOWN"}


def test_who_answers_commands_alone_is_not_missing_where_nobody_commands() -> None:
    leg = next(joint for joint in load_robot("h24-mixed").joints if joint.bus == "l_leg")
    assert isinstance(leg.type, CanType)
    assert is_queried(leg)
    assert not is_queried(replace(leg, type=replace(leg.type, family="cubemars")))


def test_a_robot_in_sim_has_no_buses_to_look_at(tmp_path: Path) -> None:
    file = tmp_path / "twind.yaml"
    file.write_text("mode: sim\nrobot: h24\n")
    outcome = look("--config", str(file), only=[code for check in CHECKS for code in check.codes])
    assert (outcome.found, outcome.looked, outcome.unseen) == ([], [], [])


def test_where_nothing_was_looked_at_nothing_is_called_right(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--socket", "/nowhere", "doctor", "--robot", "h24", "--only"]
    assert main([*words, "LATENCY_FLOOR"]) == 1
    *_, last = capsys.readouterr().out.splitlines()
    assert last == "nothing is known; looked at 0 things; could not look at: latency (no serial port)"
    assert main(["--json", *words, "LATENCY_FLOOR"]) == 1
    said = json.loads(capsys.readouterr().out)
    assert (said["looked"], said["not_looked"]) == ([], [{"what": "latency", "why": "no serial port"}])
    assert main(["--socket", "/nowhere", "calibrate", "scan", "--robot", "h24"]) == 1
    *_, last = capsys.readouterr().out.splitlines()
    assert last.startswith("nothing is known; looked at 0 things; could not look at: serial buses, servos (")
    assert main([*words, "FILE_REFUSED"]) == 0
    assert "nothing wrong; looked at 1 thing" in capsys.readouterr().out


def test_a_bus_without_a_port_is_said_to_be_unseen(tmp_path: Path) -> None:
    outcome = look("--robot", "h24", only=["BUS_SILENT"])
    assert not outcome.found
    assert outcome.unseen == [("serial buses", "bus main has no port: name it with --port")]


def test_who_is_there_is_looked_for_where_the_port_is_free_and_else_by_the_daemon(tmp_path: Path) -> None:
    """While a daemon has the port, `scan --port` is refused."""
    spec = ROBOT.buses[0]
    joints = ROBOT.joints
    for servos, code in (((), "BUS_SILENT"), ((servo(joints[1]),), "SERVO_MISSING")):
        survey = SerialSurvey(spec, "/dev/ttyUSB0", servos, joints[:1])
        seen = CheckContext(HostInspector(), "twind.service", robot=ROBOT, surveys={"main": survey})
        checks = [check for check in CHECKS if code in check.codes]
        (alone,) = runner.run(seen, checks, check_table.complaints()).found
        assert alone.code == code and "`twindctl scan --port /dev/ttyUSB0` looks for" in alone.advice
        told = {"status": dict.fromkeys(("version", "robot", "mode", "state"), "mirror"), "joints": []}
        with answering(tmp_path / f"{code}.sock", told):
            seen.daemon = DaemonInspector(Client(tmp_path / f"{code}.sock"))
            (beside,) = runner.run(seen, checks, check_table.complaints()).found
            seen.close()
        assert beside.code == code and "`twindctl scan main`" in beside.advice
        stop = "`sudo systemctl stop twind twind-control.socket twind-observe.socket`"
        assert beside.advice.index(stop) < beside.advice.index("`twindctl scan --port /dev/ttyUSB0`")


def test_one_complaint_about_many_servos_is_told_once_and_mended_for_all() -> None:
    done: list[int] = []
    same = [
        DoctorFinding(
            "RETURN_DELAY",
            Devices("main", [(id, f"j{id}")]),
            "500 us",
            "10 us",
            f"write {id}",
            _fix(done, id),
        )
        for id in range(1, 6)
    ]
    apart = DoctorFinding("RETURN_DELAY", Devices("main", [(9, "j9")]), "500 us", "10 us", "write 9")
    one, other = merge_findings([*same, apart])
    assert one.thing == "bus main ids 1 (j1), 2 (j2), 3 (j3), 4 (j4), 5 (j5)"
    assert one.command.splitlines() == [f"write {id}" for id in range(1, 6)]
    assert one.fix is not None
    assert str(one.fix) == f"{one.thing}: delay := 5"
    one.fix.do()
    assert done == [1, 2, 3, 4, 5]
    assert other is apart, "what cannot be mended now is told apart"


def _fix(done: list[int], id: int) -> Fix:
    return Fix("delay := 5", lambda: done.append(id), Devices("main", [(id, f"j{id}")]))


@pytest.mark.parametrize("message", ["x", "main: no reply to ping from [1]"])
@pytest.mark.parametrize("silent", [True, False])
def test_a_bus_on_which_no_device_answers_is_known_by_its_field(message: str, silent: bool) -> None:
    class Deaf(Client):
        def stream(self, method: str, **parameters: object) -> Iterator[Mapping[str, object]]:
            given = {"bus": "main", "message": message, "silent": silent}
            raise CallError("io.twind.Control.BusFailed", given)

    client = Deaf("/nowhere")
    if silent:
        assert daemon_survey._scan(client, "main") == {}
    else:
        with pytest.raises(CheckUnavailable, match="bus main"):
            daemon_survey._scan(client, "main")


@pytest.mark.parametrize(
    ("full", "asleep", "other", "code"),
    [
        (True, "", False, "DAEMON_SILENT"),
        (False, "twind.service", False, "NO_DAEMON"),
        (False, "", True, "NO_DAEMON"),
        (False, "", False, "NO_DAEMON"),
    ],
)
def test_why_no_daemon_answers_is_known_without_its_words(
    tmp_path: Path, full: bool, asleep: str, other: bool, code: str
) -> None:
    (tmp_path / "control.sock").touch()
    world = CheckContext(host=HostInspector(), unit="twind.service")
    world.sockets = str(tmp_path)
    world.no_daemon = NoDaemon("x", full=full)
    world.asleep = asleep
    world.other_ports = other
    (found,) = service_checks.reach(world)
    assert found.code == code
    assert (asleep in found.measured) and (not other or "other ports" in found.measured)
