"""The doctor on real ports: what is planted in a robot is found, on the free port and through the daemon."""

import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from tests.support.doctor_cases import (
    AWAY,
    LEGS,
    LIMP,
    LINE,
    MENDABLE,
    ODD,
    OLDER,
    STRANGE,
    TIGHT,
    UNCALIBRATED,
    WIRES,
)
from tests.support.doctor_odd_robots import Loose, legs, old_servo, wrong_legs
from tests.support.doctor_rig import options
from tests.support.doctor_robot import BAUD, Case, Ground, Vendor, planted, ready, upper_body
from tests.support.doctor_surveys import CHECKS as MINE
from tests.support.doctor_surveys import ROWS
from tests.support.processes import Daemon, Virtual, daemon, robot
from twind.config.robot_file import load_robot
from twind.doctor import runner
from twind.doctor.check import DoctorFinding
from twind.doctor.check_context import CheckContext, examine
from twind.doctor.host_inspector import HostInspector
from twind.doctor.runner import DoctorReport, FixResult
from twind_drivers.can.doctor import can_bus_checks as can_bus
from twind_drivers.clock import MonotonicClock
from twind_drivers.dynamixel.dynamixel_tools import TOOLS
from twind_drivers.servo_tools.doctor.serial_bus_inspector import SerialBusInspector
from twind_drivers.servo_tools.doctor.serial_bus_survey import survey_port

RECORDED = (10, 11, 20, 48, 52)  # what a calibration remembers of a servo's registers


@pytest.fixture(scope="module")
def ground(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ground]:
    """Twelve servos, without physics: none of this moves."""
    file = upper_body(tmp_path_factory.mktemp("doctored"))
    with robot(str(file), "--muscles", "first-order") as (virtual, _):
        yield Ground(virtual)


def look(virtual: Virtual, *words: str, running: Daemon | None = None) -> DoctorReport:
    """Findings of the doctor's checks of buses and servos."""
    seen = survey(virtual, *words, running=running)
    try:
        return runner.run(seen, MINE, ROWS)
    finally:
        seen.close()


def survey(virtual: Virtual, *words: str, running: Daemon | None = None, serial: bool = True) -> CheckContext:
    """Context of the checks. On a free port ids above 30 are not pinged, which saves a second."""
    given = ["--robot", virtual.robot, "--calibration", str(virtual.calibration)]
    if running is None:
        for bus, port in virtual.ports.items():
            given += ["--port", f"{bus}={'can:slcan:' if bus.endswith('leg') else ''}{port}"]
    socket = "/nowhere/at/all" if running is None else running.sockets
    seen = examine(options(*given, *words, socket=socket), HostInspector(), MonotonicClock())
    for name, line in seen.lines.items() if serial else ():
        if isinstance(line, SerialBusInspector):
            seen.surveys[name] = survey_port(line, seen.bus(name), seen.need_robot(), range(31))
    return seen


def describe(outcome: DoctorReport) -> list[str]:
    return [f"{each.code} {each.thing}: {each.measured}" for each in outcome.found]


def hit(case: Case, found: Iterable[DoctorFinding]) -> list[DoctorFinding]:
    """The findings of this case about its servo."""
    return [
        each
        for each in found
        if each.code == case.code
        and (not case.id or re.search(rf"\bid {case.id}\b", f"{each.thing} {each.measured}"))
        and case.told in f"{each.thing} {each.measured}"
    ]


def require(cases: tuple[Case, ...], outcome: DoctorReport) -> None:
    """Each is found once, and nothing that was not planted; what a calibration records may be changed."""
    missed = [case.code for case in cases if len(hit(case, outcome.found)) != case.times]
    assert not missed, "\n".join([*missed, *describe(outcome), *map(str, outcome.unseen)])
    assert not outcome.unseen
    recorded = {case.id for case in cases for address, _ in case.registers if address in RECORDED}
    recorded |= {case.id for case in cases if case.code == "CALIBRATION_CHANGED"}
    changed = [each for each in outcome.found if each.code == "CALIBRATION_CHANGED"]
    assert {int(re.findall(r" id (\d+)", each.thing)[0]) for each in changed} == recorded
    others = {each.code for each in outcome.found} - {"CALIBRATION_CHANGED"}
    assert others == {case.code for case in cases} - {"CALIBRATION_CHANGED"}, describe(outcome)


def mended(
    virtual: Virtual, outcome: DoctorReport, codes: set[str], running: Daemon | None = None
) -> dict[str, FixResult]:
    """Results of `--fix --yes` for these findings."""
    outcome.found = [each for each in outcome.found if each.code in codes]
    done = runner.mend(outcome, lambda: survey(virtual, running=running), MINE, ROWS)
    return {each.found.code: each for each in done}


def test_a_healthy_robot_has_no_finding(ground: Ground) -> None:
    outcome = look(ground.virtual)
    assert not describe(outcome)
    assert outcome.looked == ["serial buses", "servos"]


def test_planted_servo_faults_are_found_on_the_port_and_by_the_daemon_and_fixed(
    ground: Ground, tmp_path: Path
) -> None:
    # Arming sets the watchdog anew, so one that is left hinders no live daemon.
    told = tuple(case for case in LIMP if case.code != "WATCHDOG_LEFT")
    with planted(ground, LIMP):
        outcome = look(ground.virtual)
        require(LIMP, outcome)
        done = mended(ground.virtual, outcome, {"RETURN_DELAY", "STATUS_LEVEL"})
        assert set(done) == {"RETURN_DELAY", "STATUS_LEVEL"}
        assert not [each for each in done.values() if each.error or each.there]
        with Vendor(ground.port) as vendor:
            assert vendor.read(1, 9) == 5
            assert vendor.read(2, 68) == 2
            vendor.write(1, 9, 250)
            vendor.write(2, 68, 1)

        with daemon(ground.virtual, tmp_path) as running:
            ready(running)
            ready(running, "temperature")  # told last, with the voltage
            outcome = look(ground.virtual, running=running)
            require(told, outcome)
            wanted = {case.code for case in told if case.mended}
            done = mended(ground.virtual, outcome, wanted, running)
            assert set(done) == wanted
            assert not [each for each in done.values() if each.error or each.there]
            running.end()
        with Vendor(ground.port) as vendor:
            for case in told:
                if case.mended:
                    assert vendor.read(case.id, case.mended[0]) == case.mended[1], case.code
    assert not describe(look(ground.virtual))


def test_torque_without_a_daemon_is_reported_and_nothing_is_written_to_that_servo(ground: Ground) -> None:
    with planted(ground, (*MENDABLE, *TIGHT)):
        outcome = look(ground.virtual)
        require((*MENDABLE, *TIGHT), outcome)
        assert [each.fix for each in outcome.found if each.code == "RETURN_DELAY"] == [None], "torque is on"
        untouched(ground)


@pytest.mark.slow
def test_the_doctor_reports_torque_and_missing_servos_through_the_daemon(
    ground: Ground, tmp_path: Path
) -> None:
    with planted(ground, (*MENDABLE, *TIGHT)):
        with daemon(ground.virtual, tmp_path) as running:
            ready(running)
            ground.virtual.order(fault="silence", id=4)
            outcome = look(ground.virtual, running=running)
            ground.virtual.order(fault="clear")
            require((*MENDABLE, *TIGHT, LINE[0]), outcome)
            assert [each.fix for each in outcome.found if each.code == "RETURN_DELAY"] == [None], (
                "torque is on"
            )
            running.process.kill()  # a daemon that ends well would lower the robot
        untouched(ground)
    assert not describe(look(ground.virtual))


def untouched(ground: Ground) -> None:
    """A diagnosis changed no torque. Then the tripped watchdog is cleared: before, it takes nothing."""
    with Vendor(ground.port) as vendor:
        assert [vendor.read(id, 64) for id in (1, 2)] == [1, 1]
        vendor.write(2, 98, 0)


def test_torque_that_came_on_meanwhile_stops_a_mending(ground: Ground) -> None:
    with planted(ground, MENDABLE):
        outcome = look(ground.virtual)
        with Vendor(ground.port) as vendor:
            ground.set(vendor, 1, 64, 1)
        [done] = runner.mend(outcome, lambda: survey(ground.virtual), MINE, ROWS)
        assert "torque is on by now" in done.error
        assert done.there
        with Vendor(ground.port) as vendor:
            assert vendor.read(1, 9) == 20


def test_a_reversed_servo_is_reported_even_without_a_calibration(ground: Ground) -> None:
    with planted(ground, UNCALIBRATED):
        seen = survey(ground.virtual)
        assert "CALIBRATION_CHANGED" in {each.code for each in runner.run(seen, MINE, ROWS).found}
        seen.calibration = None
        found = runner.run(seen, MINE, ROWS).found
        seen.close()
        assert all(len(hit(case, found)) == 1 for case in UNCALIBRATED)
        assert {each.code for each in found} == {"OPERATING_MODE"}


def test_a_firmware_changed_since_the_calibration_is_reported(ground: Ground) -> None:
    seen = survey(ground.virtual)
    old = {case.id for case in OLDER}
    assert seen.calibration is not None
    joints = tuple(
        replace(joint, device=replace(joint.device, firmware=45)) if joint.id in old else joint
        for joint in seen.calibration.joints
    )
    seen.calibration = replace(seen.calibration, joints=joints)
    require(OLDER, runner.run(seen, MINE, ROWS))
    seen.close()


@pytest.mark.parametrize("case", LINE, ids=[case.code for case in LINE])
def test_each_planted_line_fault_is_found(ground: Ground, case: Case) -> None:
    ground.virtual.order(**dict(case.order))
    try:
        outcome = look(ground.virtual)
    finally:
        ground.virtual.order(**dict(case.heal))
    assert hit(case, outcome.found), describe(outcome)


def test_foreign_duplicate_outdated_and_missing_servos_are_all_found(
    tmp_path: Path,
) -> None:
    """Five of the robot's twelve ids answer, some with wrong settings; others answer at other rates."""
    virtual = Loose(tmp_path, str(upper_body(tmp_path)), ODD)
    try:
        with Vendor(virtual.ports["main"]) as vendor:
            vendor.talk.write1ByteTxRx(vendor.port, 9, 7, 1)  # id 9 becomes what the factory delivers
            vendor.talk.write1ByteTxRx(vendor.port, 1, 8, 1)
        outcome = look(virtual)
        missed = [case.code for case in STRANGE if len(hit(case, outcome.found)) != 1]
        assert not missed, "\n".join([*missed, *describe(outcome), *map(str, outcome.unseen)])
        [fresh] = [each for each in outcome.found if "adopt" in each.command]
        assert fresh.command == "twindctl adopt JOINT"
        with Vendor(virtual.ports["main"]) as vendor:
            vendor.talk.write1ByteTxRx(vendor.port, 5, 8, 3)  # 1 Mbaud
        outcome = look(virtual)
        assert all(len(hit(case, outcome.found)) == 1 for case in AWAY), describe(outcome)
    finally:
        virtual.close()


def test_a_servo_of_protocol_1_is_reported(tmp_path: Path) -> None:
    robot = load_robot(str(upper_body(tmp_path)))
    with old_servo() as port:
        line = SerialBusInspector(port, BAUD, HostInspector(), MonotonicClock(), TOOLS)
        seen = CheckContext(HostInspector(), "twind.service", robot=robot, lines={"main": line})
        seen.surveys["main"] = survey_port(line, robot.buses[0], robot, range(13))
        outcome = runner.run(seen, MINE, ROWS)
        seen.close()
    measured = [each.measured for each in outcome.found if each.code == "BAUD_WRONG"]
    assert measured == ["protocol 1.0 answers of ids 7"]


@pytest.fixture(scope="module")
def walker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Virtual]:
    """Serial arms and two legs on CAN."""
    file = legs(tmp_path_factory.mktemp("legs"))
    with robot(str(file), "--muscles", "first-order") as (virtual, _):
        yield virtual


def test_a_healthy_robot_with_can_has_no_finding_on_its_ports(walker: Virtual) -> None:
    outcome = look(walker)
    assert {each.code for each in outcome.found} == {"WATCHDOG_UNKNOWN"}, describe(outcome)
    assert outcome.looked == ["serial buses", "servos", "CAN actuators"]


def test_planted_can_actuator_faults_are_found_on_the_port(walker: Virtual) -> None:
    with wrong_legs(walker):
        require(LEGS, look(walker))
    assert {each.code for each in look(walker).found} == {"WATCHDOG_UNKNOWN"}


@pytest.mark.slow
def test_planted_can_actuator_faults_are_found_through_the_daemon(walker: Virtual, tmp_path: Path) -> None:
    with wrong_legs(walker), daemon(walker, tmp_path, mode="mirror") as running:
        ready(running, "heard", but="l_ankle_pitch")
        require(LEGS, look(walker, running=running))
        running.end()


@pytest.mark.parametrize("case", WIRES, ids=[case.code for case in WIRES])
def test_each_planted_can_line_fault_is_found(walker: Virtual, case: Case) -> None:
    on_can = [check for check in MINE if check.what == can_bus.ACTUATORS]
    walker.order(bus="l_leg", **dict(case.order))
    seen = survey(walker, serial=False)
    try:
        found = runner.run(seen, runner.select_checks(on_can, [case.code]), ROWS).found
    finally:
        seen.close()
        walker.order(bus="l_leg", **dict(case.heal))
    assert len(hit(case, found)) == 1, found


@pytest.mark.slow
@pytest.mark.parametrize("name", ["h24", "h24-mixed"])
def test_the_built_in_robots_have_no_finding_on_ports_and_through_the_daemon(
    name: str, tmp_path: Path
) -> None:
    with robot(name) as (virtual, _):
        assert not describe(look(virtual))
        with daemon(virtual, tmp_path) as running:
            running.reach(state="connected")
            outcome = look(virtual, running=running)
            assert not describe(outcome)
            assert not outcome.unseen
            running.end()


def test_every_code_of_buses_and_devices_has_a_planted_case() -> None:
    cases = (*LIMP, *TIGHT, *UNCALIBRATED, *OLDER, *LINE, *STRANGE, *AWAY, *LEGS, *WIRES)
    others = {"IMU_GRAVITY"}  # test_imu.py
    assert {case.code for case in cases} | others == {code for check in MINE for code in check.codes}
