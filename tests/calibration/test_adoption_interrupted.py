"""`twindctl adopt` cut short: nothing loses a servo, and no old calibration outlives one. In process."""

from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

from tests.support.adoption_rig import Bench, Killed, fresh, is_home, robot_of, settled, there
from tests.support.examples import examples
from twind.command_line.verb import Rejected
from twind.config.calibration_file import fitting, load_calibration, save_calibration
from twind.config.device_check import compare
from twind.config.robot_spec import RobotFile
from twind.robot.finding import ReasonCode
from twind_calibration.calibrating import calibration_draft as drafts
from twind_calibration.calibrating.calibration_draft import DraftTravel
from twind_calibration.robot_description import read
from twind_drivers.bus import IdentifiedDevice
from twind_drivers.dynamixel.dynamixel_tools import RATES
from twind_drivers.servo_tools.adoption.calibration_entry_status import entry_of
from twind_drivers.servo_tools.adoption.candidate_locations import joint_of, ways
from twind_drivers.servo_tools.family_tools import ServoLocation


@pytest.fixture
def robot(tmp_path: Path) -> RobotFile:
    return robot_of(tmp_path, {"elbow": 1, "wrist": 7, "thumb": 9})


# ------------------------------------------------------------------------------------- interruptions


@pytest.mark.parametrize("after", [False, True])
@pytest.mark.parametrize("power", [False, True])
def test_killed_at_any_write_the_same_command_ends_the_job(
    robot: RobotFile, after: bool, power: bool
) -> None:
    writes = 0
    ended = False
    while not ended:
        bench = Bench(robot, [settled(1), settled(9), fresh()])
        others = [bench.eeprom(0), bench.eeprom(1)]
        ended = not bench.killed(writes, "wrist", after=after)
        place = ServoLocation(bench.value(2, "id"), RATES[bench.value(2, "baud_rate")])
        assert place in ways(robot, joint_of(robot, "wrist"))
        if power:
            bench.power_cycle()
        bench.adopt()  # nobody needs to say which: it is the one that is missing still
        assert is_home(bench, 2)
        assert [bench.eeprom(0), bench.eeprom(1)] == others
        writes += 1
    assert writes > 5  # three registers, id, rate


@examples(25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_an_interrupted_adoption_leaves_a_findable_servo_and_the_next_run_completes_it(
    robot: RobotFile, data: st.DataObject
) -> None:
    bench = Bench(robot, [settled(1), settled(9), fresh()])
    others = [bench.eeprom(0), bench.eeprom(1)]
    for _ in range(data.draw(st.integers(1, 3))):
        try:
            adoption = bench.look("wrist")
            assert adoption is not None
            bench.bus.faults.drop(data.draw(st.integers(0, 12)))
            bench.bus.faults.corrupt(data.draw(st.integers(0, 6)))
            bench.port.left = data.draw(st.integers(0, 8))
            adoption.carry_out()
        except (Rejected, Killed):
            pass
        bench.port.left = float("inf")
        bench.bus.faults.clear()
        if data.draw(st.booleans()):
            bench.power_cycle()
        place = ServoLocation(bench.value(2, "id"), RATES[bench.value(2, "baud_rate")])
        assert place in ways(robot, joint_of(robot, "wrist"))
        assert bench.value(2, "torque_enable") == 0
    bench.adopt()
    assert is_home(bench, 2)
    assert [bench.eeprom(0), bench.eeprom(1)] == others


def test_a_servo_that_loses_power_during_adoption_is_reported_and_found_again(robot: RobotFile) -> None:
    bench = Bench(robot, [settled(1), settled(9), fresh()])
    adoption = there(bench.look())
    bench.bus.faults.silence(id=1)
    with pytest.raises(Rejected, match="is its power on"):
        adoption.carry_out()
    bench.bus.faults.clear()
    bench.adopt()
    assert is_home(bench, 2)


# ------------------------------------------------------------------------------------- the calibration


def calibrated(robot: RobotFile, folder: Path) -> Path:
    """A file in which every joint stands, with the registers that a new servo will hold too."""
    held = {
        "homing_offset": 0,
        "drive_mode": 0,
        "operating_mode": 3,
        "min_position_limit": 0,
        "max_position_limit": 4095,
    }
    devices = {("main", j.id): IdentifiedDevice(j.id, 1020, "XM430-W350", 47, held) for j in robot.joints}
    zeros = dict.fromkeys(robot.names, 2048)
    made = fitting(robot, zeros, devices, created="2026-11-21T09:14:03Z", tool="a test")
    return save_calibration(made, folder, "bench")


def test_the_old_servos_calibration_goes_before_the_first_write(robot: RobotFile, tmp_path: Path) -> None:
    path = calibrated(robot, tmp_path)
    bench = Bench(robot, [settled(1), settled(9), fresh()])
    adoption = there(bench.look(entry=entry_of(robot, path, "wrist", path)))
    assert "its entry is taken out" in adoption.lines()[-1]
    assert "wrist" in load_calibration(path, robot).by_name  # not by looking
    bench.port.left = 0
    with pytest.raises(Killed):
        adoption.carry_out()
    assert bench.port.writes == []
    left = load_calibration(path, robot)
    assert sorted(left.by_name) == ["elbow", "thumb"]
    bench.port.left = float("inf")
    bench.adopt(entry=entry_of(robot, path, "wrist", path))
    same = {"return_delay_time": 10, "shutdown": 53, "current_limit": 600, "startup_configuration": 0}
    held = {"homing_offset": 0, "drive_mode": 0, "operating_mode": 3, "secondary_shadow_id": 255}
    ends = {"min_position_limit": 0, "max_position_limit": 4095}
    devices = {
        ("main", j.id): IdentifiedDevice(j.id, 1020, "XM430-W350", 47, {**same, **held, **ends})
        for j in robot.joints
    }
    refused = compare(robot, left, devices).refusals
    assert [(each.code, robot.names[each.joint or 0]) for each in refused] == [
        (ReasonCode.CALIB_MISSING, "wrist")
    ]


@pytest.mark.parametrize("calibrated_too", [True, False])
def test_adoption_removes_the_draft_travel_of_the_old_servo(
    robot: RobotFile, tmp_path: Path, calibrated_too: bool
) -> None:
    """With equal model and settings `zero` could not distinguish it from the travel of the new servo."""
    path = calibrated(robot, tmp_path)
    device = load_calibration(path, robot).by_name["wrist"].device
    swept = DraftTravel(device, (1000, 3000), "2026-11-21T09:14:03Z")
    drafts.change(path, robot, lambda known: known.joined("wrist", swept).joined("elbow", swept))
    if not calibrated_too:
        path.unlink()
    entry = entry_of(robot, path if calibrated_too else None, "wrist", path)
    bench = Bench(robot, [settled(1), settled(9), fresh()])
    adoption = there(bench.look(entry=entry))
    assert "wrist was swept, 2026-11-21T09:14:03Z: its travel is taken out" in adoption.lines()[-1]
    assert "wrist" in drafts.load(path, robot).swept  # not by looking
    bench.port.left = 0
    with pytest.raises(Killed):
        adoption.carry_out()
    assert set(drafts.load(path, robot).swept) == {"elbow"}
    assert path.exists() == calibrated_too
    bench.port.left = float("inf")
    bench.adopt(entry=entry_of(robot, path if calibrated_too else None, "wrist", path))
    assert is_home(bench, 2)


def test_without_a_calibration_the_draft_is_searched_at_its_usual_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    files = Namespace(config=None, robot="h24", calibration=None, port=["/dev/null"], socket=None)
    described = read(files)
    assert described.calibration is None
    assert described.usual == tmp_path / "calibration" / "h24.yaml"


def test_entries_calibrated_since_the_start_of_an_adoption_are_kept(robot: RobotFile, tmp_path: Path) -> None:
    path = calibrated(robot, tmp_path)
    entry = entry_of(robot, path, "wrist", path)
    known = load_calibration(path, robot)
    elbow = replace(known.by_name["elbow"], zero_ticks=2060)
    others = [elbow if each.name == "elbow" else each for each in known.joints]
    save_calibration(replace(known, joints=tuple(others)), tmp_path, "bench")
    entry.strike_out()
    assert load_calibration(path, robot).by_name["elbow"] == elbow


def test_a_calibrated_joint_with_its_servo_keeps_its_calibration_and_its_registers(
    robot: RobotFile, tmp_path: Path
) -> None:
    path = calibrated(robot, tmp_path)
    before = path.read_bytes()
    bench = Bench(robot, [settled(1), settled(9), settled(7, min_position_limit=100)])
    held = bench.eeprom(2)
    with pytest.raises(Rejected, match=r"nothing to adopt\. .*min_position_limit \(52\): 100 -> 0.* doctor"):
        bench.adopt("wrist", entry_of(robot, path, "wrist", path))
    assert (path.read_bytes(), bench.eeprom(2), bench.port.writes) == (before, held, [])
    path.chmod(0o644)
    entry_of(robot, path, "wrist", path).strike_out()  # as the refusal says
    assert path.stat().st_mode & 0o777 == 0o644, "who could read it still can"
    bench.adopt("wrist", entry_of(robot, path, "wrist", path))
    assert is_home(bench, 2) and bench.value(2, "min_position_limit") == 0


def test_a_calibration_that_cannot_be_written_stops_it_before_the_first_write(
    robot: RobotFile, tmp_path: Path
) -> None:
    path = calibrated(robot, tmp_path)
    odd = path.with_suffix(".txt")
    path.rename(odd)
    bench = Bench(robot, [settled(1), settled(9), fresh()])
    with pytest.raises(Rejected, match=r"entry of wrist must go .* does not end in \.yaml"):
        bench.adopt(entry=entry_of(robot, odd, "wrist", path))
    assert bench.port.writes == []


def test_a_file_without_the_joint_is_left_alone(robot: RobotFile, tmp_path: Path) -> None:
    path = calibrated(robot, tmp_path)
    entry_of(robot, path, "wrist", path).strike_out()
    before = path.read_bytes()
    entry_of(robot, path, "wrist", path).strike_out()
    entry_of(robot, None, "wrist", path).strike_out()
    assert path.read_bytes() == before
    for name in ("elbow", "thumb"):
        entry_of(robot, path, name, path).strike_out()
    assert load_calibration(path, robot).joints == ()


def test_a_calibration_file_that_cannot_be_read_is_named(robot: RobotFile, tmp_path: Path) -> None:
    path = tmp_path / "bench.yaml"
    path.write_text("format: nonsense\n")
    with pytest.raises(Rejected, match="entry of wrist must be readable first"):
        entry_of(robot, path, "wrist", path)
