"""The robot file: what is described is there, what is wrong is refused at its line."""

import math
import re
from pathlib import Path

import pytest

from tests.support.small_robot_file import SMALL, read, write
from twind.config.robot_file import built_in_robots, load_robot, read_robot
from twind.config.yaml_tree import ConfigError


def test_every_described_value_is_read(tmp_path: Path) -> None:
    robot = read(tmp_path)
    shoulder, elbow = robot.joints
    assert robot.names == ("shoulder", "elbow")
    assert (robot.name, robot.support, robot.rate_hz, robot.base) == ("arm-2", "fixed", 50.0, "base")
    assert robot.bus("main").port == "/dev/ttyUSB0"
    assert (shoulder.sign, shoulder.ratio, shoulder.model_joint) == (1, 1.0, "shoulder")
    assert (elbow.sign, elbow.ratio, elbow.lower, elbow.upper) == (-1, 2.0, 0.0, pytest.approx(math.pi / 2))
    assert shoulder.type.gains.p == 800
    assert robot.poses["up"] == {"shoulder": 0.5, "elbow": 0.0}
    assert robot.motions == tmp_path / "motions"
    assert robot.mjcf.startswith("<!--")


def test_paths_of_a_robot_that_was_named_by_a_relative_path_are_absolute(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = read(tmp_path)
    monkeypatch.chdir(tmp_path)
    robot = load_robot(f"./{known.path.name}")
    assert (robot.path, robot.mjcf_path, robot.motions) == (known.path, known.mjcf_path, known.motions)
    assert robot.motions.is_absolute()


def test_limits_of_a_joint_are_the_tightest_of_type_and_joint_at_the_joint(tmp_path: Path) -> None:
    shoulder, elbow = read(tmp_path).joints
    assert (shoulder.velocity_limit, shoulder.acceleration_limit) == (4.0, 20.0)
    assert (elbow.velocity_limit, elbow.acceleration_limit) == (
        1.5,
        10.0,
    )  # a gear of 2 halves what the type can


def test_the_mode_is_the_joints_own_else_its_types(tmp_path: Path) -> None:
    assert [joint.mode for joint in read(tmp_path).joints] == ["position", "position"]
    text = SMALL.replace("device: XM430-W350", "device: XM430-W350, mode: extended_position")
    shoulder, elbow = read(tmp_path, text.replace("id: 2,", "id: 2, mode: current_based_position,")).joints
    assert (shoulder.operating_mode, shoulder.current_cap) == (4, None)
    assert (elbow.operating_mode, elbow.current_cap) == (5, 855)  # 2.3 A in counts of 2.69 mA, rounded down
    (shoulder, elbow) = read(
        tmp_path, SMALL.replace("bus: main}", "bus: main, mode: extended_position}")
    ).joints
    assert {shoulder.operating_mode, elbow.operating_mode} == {4}


def test_the_follow_bounds_are_the_joints_own_else_its_types_else_not_stated(tmp_path: Path) -> None:
    assert {(joint.follow_rad, joint.follow_s) for joint in read(tmp_path).joints} == {(None, None)}
    text = SMALL.replace("device: XM430-W350", "device: XM430-W350, follow_rad: 0.4, follow_s: 0.25")
    text = text.replace("id: 2,", "id: 2, follow_deg: 45,")
    shoulder, elbow = read(tmp_path, text).joints
    assert (shoulder.follow_rad, shoulder.follow_s) == (0.4, 0.25)
    assert (elbow.follow_rad, elbow.follow_s) == (pytest.approx(math.pi / 4), 0.25)


@pytest.mark.parametrize("key", ["follow_rad: 0.01", "follow_rad: 1.6", "follow_s: 0.01", "follow_s: 2.1"])
@pytest.mark.parametrize("at", ["device: XM430-W350", "id: 2"])
def test_a_follow_bound_out_of_range_is_refused_at_its_place(tmp_path: Path, key: str, at: str) -> None:
    name, _, value = key.partition(": ")
    with pytest.raises(ConfigError, match=rf":\d+:\d+: .*{name}: {value} is outside >= 0.02 and <= "):
        read(tmp_path, SMALL.replace(at, f"{at}, {key}"))


def test_a_cap_that_is_a_whole_number_of_counts_keeps_its_last_count(tmp_path: Path) -> None:
    text = SMALL.replace("current_limit_a: 2.3", "mode: current_based_position, current_limit_a: 2.69")
    assert read(tmp_path, text).joints[0].current_cap == 1000


def test_the_one_write_setting_is_on_unless_the_robot_file_disables_it(tmp_path: Path) -> None:
    assert read(tmp_path).bus("main").one_write is True
    text = SMALL.replace("baud: 1000000", "baud: 1000000, one_write: false")
    assert read(tmp_path, text).bus("main").one_write is False


def test_registers_of_a_joint_override_those_of_its_type(tmp_path: Path) -> None:
    shoulder, elbow = read(tmp_path).joints
    assert shoulder.registers == {"shutdown": 52}
    assert elbow.registers == {"shutdown": 53}


def test_unknown_support_counts_as_free(tmp_path: Path) -> None:
    assert read(tmp_path, SMALL.replace("support: fixed\n", "")).support == "free"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("twind-robot/1", "twind-robot/2", ":1:9: format: 'twind-robot/2' is not twind-robot/1"),
        ("name: arm-2", "name: Arm 2", ":2:7: name: 'Arm 2' has a wrong form; use 1 to 64 of a-z"),
        ("arm.xml", "absent.xml", ":3:15: model.mjcf: "),
        (
            "support: fixed",
            "support: gantri",
            ":4:10: support: 'gantri' is none of fixed, gantry, free; nearest: gantry",
        ),
        ("rate_hz: 50", "rate_hz: 5", ":5:17: loop.rate_hz: 5 is outside >= 10 and <= 1000"),
        ("rate_hz: 50", "rate: 50", ":5:8: loop.rate: unknown key; nearest: rate_hz"),
        ("kind: dynamixel2", "kind: can", "buses.main.baud: unknown key; known: kind, port, bitrate"),
        ("baud: 1000000", "baud: 1000001", "1000001 is none of 9600, 57600"),
        ("gains: {p: 800, i: 0, d: 0}, ", "gains: {i: 0, d: 0}, ", "gains.p: is required and missing"),
        (
            "device: XM430-W350",
            "device: XM430-W350, mode: velocity",
            "types.xm.mode: mode velocity takes speeds, and the daemon commands positions: use one of",
        ),
        ("id: 1,", "id: 1, mode: current,", "joints.shoulder.mode: mode current takes currents"),
        (
            "device: XM430-W350",
            "device: XM430-W350, mode: current_position",
            "'current_position' is none of position, extended_position, current_based_position",
        ),
        ("id: 1,", "id: 1, mode: pwm,", "joints.shoulder.mode: 'pwm' is none of position, extended_position"),
        (
            "torque_constant_nm_per_a: 1.78, current_limit_a: 2.3",
            "mode: current_based_position",
            "joints.shoulder.mode: mode current_based_position needs current_limit_a in type xm",
        ),
        (
            "current_limit_a: 2.3",
            "mode: current_based_position, current_limit_a: 0.001",
            ":9:136: types.xm.current_limit_a: 0.001 A is outside 0.00269..3.209 A, what a XM430-W350 takes",
        ),
        (
            "current_limit_a: 2.3",
            "mode: current_based_position, current_limit_a: 4.0",
            ":9:136: types.xm.current_limit_a: 4 A is outside 0.00269..3.209 A, what a XM430-W350 takes",
        ),
        (
            "device: XM430-W350",
            "device: XL430-W250, mode: current_based_position",
            "mode: type xm: XL430-W250 has no goal_current: mode 5 is not possible",
        ),
        (
            "device: XM430-W350",
            "device: XM430-W351",
            ":9:16: types.xm.device: no Dynamixel model 'XM430-W351'; near: ",
        ),
        (  # of another bus: before the keys that its family does not have
            "device: XM430-W350",
            "device: STS3215",
            ":9:16: types.xm.device: STS3215 is for buses of kind feetech; the buses here are of kind",
        ),
        (
            "device: XM430-W350",
            "device: XM999",
            ":9:16: types.xm.device: XM999 is no known model; nearest: XM430-W",
        ),
        ("device: XM430-W350", "device: XL430", "XL430 is no known model; nearest: XL430-W250"),
        ("device: XM430-W350", "device: STS3251", "STS3251 is no known model; nearest: STS3215"),
        (
            "{shutdown: 52}",
            "{shutdwn: 52}",
            "types.xm.registers.shutdwn: XM430-W350 has no shutdwn; nearest: ",
        ),
        ("{shutdown: 53}", "{shutdwn: 53}", ":15:59: joints.elbow.registers.shutdwn: XM430-W350 has no shut"),
        ("id: 1,", "id: 1, mode: 5,", "5 is a number; a mode is named: write current_based_position"),
        ("id: 1,", "id: 1, mode: 16,", "write position or extended_position or current_based_position"),
        ("baud: 1000000", "baud: 1000000, one_write: 1", "buses.main.one_write: true or false is expected"),
        ("device: XM430-W350", "device: XM430-W350, return_delay_us: 7", "7 is odd"),
        (
            "device: XM430-W350",
            "device: XM430-W350, velocity_limit: 3",
            "velocity_limit: unknown key; nearest",
        ),
        ("{shutdown: 52}", "{Shutdown: 52}", "a register is named in snake case"),
        ("type: xm,", "type: xl,", ":11:18: defaults.type: 'xl' is none of xm"),
        ("bus: main}\n", "bus: main, signn: 1}\n", "defaults.signn: unknown key; nearest: sign"),
        ("id: 1,", "id: 253,", "joints.shoulder.id: 253 is outside >= 0 and <= 252"),
        ("id: 1,", "id: true,", "joints.shoulder.id: a whole number is expected, found a truth value"),
        ("id: 1,", "", "joints.shoulder.id: is required and missing"),
        ("id: 2,", "id: 1,", ":14:15: joints.elbow.id: id 1 on bus main is that of shoulder already"),
        ("id: 2,", "id: 2, model_joint: shoulder,", "model joint shoulder is driven by shoulder already"),
        ("sign: -1", "sign: 2", "joints.elbow.sign: 2 is none of 1, -1"),
        ("sign: -1", "sign: -1.0", "a whole number is expected"),
        ("ratio: 2.0", "ratio: 0", "joints.elbow.ratio: 0 is outside > 0"),
        ("ratio: 2.0", "ratio: 5.0", "the travel is 1.25 turns of the actuator"),
        ("[-1.0, 1.0]", "[1.0, -1.0]", ":13:33: joints.shoulder.limits_rad: lower 1 is not below upper -1"),
        ("[-1.0, 1.0]", "[-1.0, .inf]", "not a finite number"),
        ("[-1.0, 1.0]", "[-100, -99]", "degrees by mistake"),
        ("limits_deg: [0, 90]", "limits_deg: [0, 90], limits_rad: [0, 1]", "limits_rad is given too"),
        ("limits_deg", "limts_deg", "joints.elbow.limts_deg: unknown key; nearest: limits_deg"),
        ("  elbow:", "  on:", "YAML reads on as a truth value"),
        ("  elbow:", "  shoulder:", "duplicate key 'shoulder', first at line 13"),
        ("  rest: {}\n", "", "poses.rest: is required and missing"),
        (
            "up: {shoulder: 0.5}",
            "up: {shoulder: 1.5}",
            ":18:18: poses.up.shoulder: 1.5 rad is outside the limits -1..1",
        ),
        ("up: {shoulder: 0.5}", "up: {sholder: 0.5}", "poses.up.sholder: unknown key; nearest: shoulder"),
        (
            "limits_deg: [0, 90]",
            "limits_deg: [10, 90]",
            "elbow: 0 rad (not given, so 0) is outside the limits",
        ),
        ("poses:\n", "passive: [shoulder]\nposes:\n", "shoulder is driven by joint shoulder"),
        ("poses:\n", "passive: [a, a]\nposes:\n", "a name stands there twice"),
        ("poses:\n", "gate: {on_velocity: clamp}\nposes:\n", "'clamp' is none of reject, retime"),
        ("poses:\n", "gate: {on_position: retime}\nposes:\n", "gate.on_position: 'retime' is none of reject"),
        ("poses:\n", "collision: {blocks_m: 1}\nposes:\n", "collision.blocks_m: unknown key"),
        ("poses:\n", "posses: {}\nposes:\n", ":16:1: posses: unknown key; nearest: poses"),
        ("buses:\n  main: {kind: dynamixel2, port: /dev/ttyUSB0, baud: 1000000}\n", "", "at least one bus"),
    ],
)
def test_an_invalid_value_is_refused_at_its_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in SMALL
    with pytest.raises(ConfigError) as caught:
        read(tmp_path, SMALL.replace(old, new, 1))
    assert message in str(caught.value)
    assert str(caught.value).startswith(str(tmp_path / "arm-2.yaml"))


def test_a_robot_without_joints_is_refused(tmp_path: Path) -> None:
    head, _, rest = SMALL.partition("joints:\n")
    with pytest.raises(ConfigError, match="at least one joint"):
        read(tmp_path, head + "joints: {}\n" + rest[rest.index("poses:") :])


def test_the_description_hash_follows_identity_and_arithmetic_only(tmp_path: Path) -> None:
    plain = read(tmp_path).description_sha256
    for old, new in [
        ("id: 1,", "id: 9,"),
        ("sign: -1", "sign: 1"),
        ("ratio: 2.0", "ratio: 2.5"),
        ("elbow:", "arm:"),
    ]:
        assert read(tmp_path, SMALL.replace(old, new)).description_sha256 != plain
    for old, new in [
        ("rate_hz: 50", "rate_hz: 60"),
        ("limits_deg: [0, 90]", "limits_deg: [0, 80]"),
        ("0.5", "0.6"),
    ]:
        assert read(tmp_path, SMALL.replace(old, new)).description_sha256 == plain


def test_built_in_robots_are_found_by_name() -> None:
    assert {"h24", "h24-mixed", "h24-split", "h24-standing", "so101"} <= set(built_in_robots())
    for name in built_in_robots():
        assert load_robot(name).name == name


def test_a_folder_comes_before_the_built_in(tmp_path: Path) -> None:
    write(tmp_path, SMALL.replace("name: arm-2", "name: h24")).rename(tmp_path / "h24.yaml")
    assert len(load_robot("h24", [tmp_path]).joints) == 2
    assert len(load_robot("h24").joints) == 24


def test_a_folder_that_may_not_be_entered_is_an_error_that_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def denied(path: Path) -> bool:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "is_file", denied)  # permissions do not bind root, who may run the tests
    with pytest.raises(ConfigError, match=r"h24\.yaml: cannot be looked for: Permission denied"):
        load_robot("h24", [tmp_path])


def test_an_unknown_name_lists_the_known() -> None:
    with pytest.raises(ConfigError, match="no robot of that name; built in: h24, h24-mixed, h24-split"):
        load_robot("h25")


def test_a_path_is_a_path_and_a_name_never_leaves_its_folder(tmp_path: Path) -> None:
    assert load_robot(str(write(tmp_path, SMALL))).name == "arm-2"
    with pytest.raises(ConfigError, match="cannot be read"):
        load_robot("../h24", [tmp_path])


@pytest.mark.parametrize("key", ["model", "buses", "types", "defaults", "joints", "poses", "name", "format"])
@pytest.mark.parametrize("misspelt", [True, False])
def test_a_section_that_is_misspelt_or_missing_is_refused_with_its_place(
    tmp_path: Path, key: str, misspelt: bool
) -> None:
    built_in = load_robot("pan-tilt").path
    for model in built_in.parent.glob("*.xml"):
        (tmp_path / model.name).write_text(model.read_text())
    gone = re.sub(rf"^{key}:.*\n(?: .*\n|\n)*", "", built_in.read_text(), flags=re.MULTILINE)
    wrong = re.sub(rf"^{key}:", f"{key}x:", built_in.read_text(), flags=re.MULTILINE)
    (tmp_path / "odd.yaml").write_text(wrong if misspelt else gone)
    reason = (
        f"unknown key; nearest: {key}" if misspelt and key != "format" else "required|needs|not described"
    )
    with pytest.raises(ConfigError, match=rf"odd\.yaml:\d+:\d+: .*({reason})"):
        read_robot(tmp_path / "odd.yaml")
