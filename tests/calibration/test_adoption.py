"""`twindctl adopt`: which servo becomes which joint, and that no interruption loses one. In process."""

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.adoption_rig import BAUD, Bench, fresh, is_home, robot_of, settled, there
from twind.command_line.verb import Rejected
from twind.config.device_check import check_devices
from twind.config.robot_file import load_robot
from twind.config.robot_spec import RobotFile
from twind.robot.finding import Verdict
from twind_drivers.dynamixel.dynamixel_reader import DynamixelReader
from twind_drivers.dynamixel.dynamixel_tools import RATES
from twind_drivers.run_script import perform
from twind_drivers.servo_tools.adoption.candidate_locations import delivered, joint_of, ways
from twind_drivers.servo_tools.family_tools import ServoLocation
from twind_drivers.virtual.virtual_servos import BAUDS


@pytest.fixture
def robot(tmp_path: Path) -> RobotFile:
    return robot_of(tmp_path, {"elbow": 1, "wrist": 7, "thumb": 9})


# ------------------------------------------------------------------------------------- what it does


def test_a_servo_as_delivered_becomes_the_one_missing_joint(robot: RobotFile) -> None:
    bench = Bench(robot, [settled(1), settled(9), fresh()])
    others = [bench.eeprom(0), bench.eeprom(1)]
    adoption = there(bench.adopt())
    assert (adoption.chosen.joint.name, adoption.chosen.place) == ("wrist", ServoLocation(1, 57_600))
    assert is_home(bench, 2)
    assert bench.value(2, "return_delay_time") == 10
    assert bench.value(2, "shutdown") == 53
    assert bench.value(2, "current_limit") == 600
    assert [bench.eeprom(0), bench.eeprom(1)] == others
    assert bench.port.writes[-2:] == [(1, 7), (7, 8)]  # the id, then the rate
    assert len(set(bench.port.writes)) == len(bench.port.writes)


def test_a_second_run_has_nothing_to_do(robot: RobotFile) -> None:
    bench = Bench(robot, [settled(1), settled(9), fresh()])
    bench.adopt()
    written = list(bench.port.writes)
    assert bench.adopt() is None
    assert there(bench.adopt("wrist")).nothing
    assert bench.port.writes == written


def test_looking_writes_nothing(robot: RobotFile) -> None:
    bench = Bench(robot, [settled(1), fresh()])
    text = "\n".join(there(bench.look("wrist")).lines())
    assert bench.port.writes == []
    assert "XM430-W350, firmware 47, id 1 at 57600 baud, torque off" in text
    assert "becomes wrist: id 7 at 1000000 baud on bus main" in text
    assert "return_delay_time (9): 250 -> 10" in text
    assert "id (7): 1 -> 7" in text


def test_an_adopted_used_servo_gets_default_values_for_unspecified_registers(robot: RobotFile) -> None:
    used = fresh(
        operating_mode=4, drive_mode=5, homing_offset=-900, secondary_shadow_id=3, startup_configuration=1,
        min_position_limit=900, max_position_limit=1100, velocity_limit=12, shutdown=0,
    )  # fmt: skip
    bench = Bench(robot, [settled(1), settled(9), used])
    bench.bus.servos.registers.put("torque_enable", 0, 2)  # it boots with torque on
    bench.bus.servos.invalidate_cache()
    bench.adopt()
    assert is_home(bench, 2)
    names = ("operating_mode", "drive_mode", "homing_offset", "secondary_shadow_id", "startup_configuration")
    assert [bench.value(2, name) for name in names] == [3, 0, 0, 255, 0]
    names = ("min_position_limit", "max_position_limit", "velocity_limit", "shutdown")
    assert [bench.value(2, name) for name in names] == [0, 4095, 200, 53]


@pytest.mark.parametrize("level", [1, 2])
def test_an_adopted_servo_that_does_not_acknowledge_writes_is_set_to_reply(
    robot: RobotFile, level: int
) -> None:
    bench = Bench(robot, [settled(1), settled(9), fresh()])
    bench.bus.servos.registers.put("status_return_level", level, 2)
    bench.bus.servos.invalidate_cache()
    bench.adopt()
    assert is_home(bench, 2)
    assert bench.value(2, "status_return_level") == 2


def test_at_the_factorys_own_rate_it_only_gets_its_id_and_settings(tmp_path: Path) -> None:
    robot = robot_of(tmp_path, {"elbow": 3, "wrist": 7}, baud=57_600)
    bench = Bench(robot, [settled(3, baud_rate=1), fresh()])
    adoption = there(bench.adopt())
    assert adoption.chosen.home == ServoLocation(7, 57_600)
    assert (bench.value(1, "id"), bench.value(1, "baud_rate")) == (7, 1)
    assert bench.adopt() is None


def test_a_joint_whose_id_is_the_factorys_keeps_it(tmp_path: Path) -> None:
    robot = robot_of(tmp_path, {"elbow": 1})
    bench = Bench(robot, [fresh()])
    bench.adopt()
    assert (bench.value(0, "id"), bench.value(0, "baud_rate")) == (1, 3)


def test_an_adopted_servo_with_the_right_id_and_rate_gets_the_remaining_settings(robot: RobotFile) -> None:
    bench = Bench(robot, [settled(1), settled(9), settled(7, return_delay_time=250)])
    assert bench.adopt() is None  # nobody is missing
    there(bench.adopt("wrist"))
    assert is_home(bench, 2)
    assert sorted(address for _, address in bench.port.writes) == [9, 38, 63]


@pytest.mark.parametrize(
    ("kind", "firmware"),
    [
        ("device: XL330-M288-T", 46),
        ("device: XL330-M288", 52),
        ("device: XL430-W250", 40),  # no startup configuration yet
        ("device: XC430-W150", 47),
        ("device: XH540-W270", 45),
        ("device: MX-28", 44),
        ("device: PH54-200-S500", 12),
        ("device: XM430-W350, mode: current_based_position, current_limit_a: 1.5", 47),
        ("device: XM430-W350, mode: extended_position", 47),
    ],
)
def test_servos_of_other_models_and_modes_are_adopted_alike(tmp_path: Path, kind: str, firmware: int) -> None:
    robot = robot_of(tmp_path, {"wrist": 7}, kind=kind)
    device = robot.joints[0].type.device
    bench = Bench(robot, [fresh(model=device, firmware=firmware)])
    there(bench.adopt())
    number = bench.value(0, "model_number")
    reader = DynamixelReader("main", bench.port, (7,), (number,), baud=BAUD, return_delay_us=500)
    devices = perform(reader, reader.identify(), bench.clock)
    found = check_devices(robot, {("main", each.id): each for each in devices})
    assert found.refusals == ()
    assert all("position limits" in each.message for each in found.warnings)  # of modes that have none


def test_the_whole_built_in_robot_takes_back_a_joint() -> None:
    h24 = load_robot("h24")
    settings = {"baud_rate": BAUDS.index(2_000_000), "return_delay_time": 5}
    others = [joint for joint in h24.joints if joint.name != "l_knee"]
    bench = Bench(h24, [*(settled(joint.id, **settings) for joint in others), fresh()])
    adoption = there(bench.adopt())
    assert adoption.chosen.joint.name == "l_knee"
    reader = DynamixelReader(
        "main", bench.port, [j.id for j in h24.joints], [1020] * 24, baud=2_000_000, return_delay_us=10
    )
    devices = perform(reader, reader.identify(), bench.clock)
    assert check_devices(h24, {("main", each.id): each for each in devices}) == Verdict()


# ------------------------------------------------------------------------------------- what it refuses


REFUSED: list[tuple[str, str | None, Callable[[], list[object]], str]] = [
    ("two missing", None, lambda: [settled(1), fresh()], "2 joints have no servo: wrist .*thumb .*Say which"),
    (
        "nobody new",
        None,
        lambda: [settled(1), settled(9)],
        "no new servo on bus main: a XM430-W350 as delive",
    ),
    (
        "half-way for another",
        "wrist",
        lambda: [settled(1), fresh(9)],
        r"id 9 at 57600 baud is no place of a new .*one may be begun for thumb: `twindctl adopt thumb`",
    ),
    (
        "two new ones apart",
        "wrist",
        lambda: [settled(1), fresh(), fresh(4)],
        "several new servos: id 1 at 57600 baud, id 4 at 57600 baud; connect one new servo at a time",
    ),
    ("two with one id", "wrist", lambda: [settled(1), fresh(), fresh()], "two devices"),
    (
        "another model",
        "wrist",
        lambda: [settled(1), fresh(model="XL430-W250")],
        "id 1 at 57600 baud is XL430-W250; wrist needs XM430-W350",
    ),
    (
        "its id is taken",
        "wrist",
        lambda: [settled(1), settled(7), fresh()],
        "wrist has a servo already, id 7 at 1000000 baud, and there is a new one, id 1 at 57600 baud",
    ),
    ("no such joint", "wirst", lambda: [settled(1), fresh()], "bench has no joint 'wirst'; nearest: wrist"),
]


@pytest.mark.parametrize(
    ("name", "specs", "message"), [each[1:] for each in REFUSED], ids=[e[0] for e in REFUSED]
)
def test_an_ambiguous_adoption_is_refused_with_the_remedy_and_writes_nothing(
    robot: RobotFile, name: str | None, specs: Callable[[], list[object]], message: str
) -> None:
    bench = Bench(robot, specs())  # type: ignore[arg-type]
    with pytest.raises(Rejected, match=message):
        bench.adopt(name)
    assert bench.port.writes == []


def set_to(name: str, value: int) -> Callable[[Bench], None]:
    def change(bench: Bench) -> None:
        bench.bus.servos.registers.put(name, value, 1)
        bench.bus.servos.invalidate_cache()

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (set_to("torque_enable", 1), "its torque is on: take its power away"),
        (set_to("status_return_level", 0), "its torque is unknown"),
        (set_to("hardware_error_status", 1), r"its hardware error is 0x01 \(input voltage\)"),
    ],
)
def test_a_servo_with_torque_or_an_error_is_refused(
    robot: RobotFile, change: Callable[[Bench], None], message: str
) -> None:
    bench = Bench(robot, [settled(1), fresh()])
    change(bench)
    with pytest.raises(Rejected, match=message):
        bench.adopt("wrist")
    assert bench.port.writes == []


def test_a_servo_that_was_only_overheard_keeps_its_place(robot: RobotFile) -> None:
    bench = Bench(robot, [settled(1), settled(7), settled(9), fresh()])
    bench.bus.faults.drop(1, id=7)  # its answer to the roll call
    with pytest.raises(Rejected, match="the place of wrist, is taken after all"):
        bench.adopt()
    assert bench.port.writes == []


def test_adoption_on_a_line_with_unsolicited_bytes_is_refused(robot: RobotFile) -> None:
    bench = Bench(robot, [settled(1), fresh()])
    bench.bus.faults.babble(on=True)
    with pytest.raises(Rejected, match="sends on this line"):
        bench.adopt("wrist")
    assert bench.port.writes == []


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (", registers: {return_delay_time: 255}", "Return Delay Time .*255 is outside 0..254; correct the"),
        (", registers: {drive_mode: 8}", "would refuse it all the same: drive_mode .10. is 8"),
        (", registers: {led: 1}", "led must be 1, but is not read from servos: remove it"),
        (", registers: {torque_enable: 1}", "torque_enable is 0, the robot file says 1"),
    ],
)
def test_an_impossible_register_value_in_the_robot_file_is_refused_before_a_write(
    tmp_path: Path, more: str, message: str
) -> None:
    bench = Bench(robot_of(tmp_path, {"wrist": 7}, more=more), [fresh()])
    with pytest.raises(Rejected, match=message):
        bench.adopt()
    assert bench.port.writes == []


def test_a_joint_of_a_can_bus_is_refused_with_what_to_do() -> None:
    mixed = load_robot("h24-mixed")
    leg = next(joint for joint in mixed.joints if joint.bus == "l_leg")
    with pytest.raises(
        Rejected, match=f"{leg.name} is a .* on CAN bus l_leg: adopt sets up serial servos only"
    ):
        joint_of(mixed, leg.name)


def test_at_one_rate_the_servo_of_another_joint_is_never_taken_for_a_new_one(tmp_path: Path) -> None:
    robot = robot_of(tmp_path, {"elbow": 1, "wrist": 7}, baud=57_600)
    bench = Bench(robot, [settled(1, baud_rate=1)])
    with pytest.raises(
        Rejected, match=r"The servo that answers there is elbow's: .* `twindctl adopt wrist` does the r"
    ):
        bench.adopt()
    assert bench.port.writes == []


# ------------------------------------------------------------------------------------- facts


def test_the_rates_are_those_of_the_register() -> None:
    assert RATES == BAUDS


@pytest.mark.parametrize("name", ["h24", "h24-split"])
def test_every_joint_of_the_built_in_robots_has_a_way_home(name: str) -> None:
    robot = load_robot(name)
    for joint in robot.joints:
        assert delivered(joint) == (ServoLocation(1, 57_600),)
        assert ways(robot, joint)[-1] == ServoLocation(joint.id, robot.bus(joint.bus).baud)
