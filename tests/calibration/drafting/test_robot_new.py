"""`twindctl robot new`: from files of other software to a robot file that `check robot` accepts."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.fake_calibration_daemon import FakeDaemon, stand_in
from tests.support.robot_description_files import INTERBOTIX, LEROBOT, POPPY, REACHY, ROBOTIS, TODDLER
from twind.command_line.verb import Rejected
from twind.config.config_files import ConfigSources, describe
from twind.config.robot_file import read_robot
from twind.ctl.ctl_main import main
from twind.exceptions import InvalidInput
from twind.virtual.virtual_robot_spec import calibration, make_spec
from twind_calibration.drafting import new_command
from twind_calibration.drafting.scan_source import devices_of
from twind_calibration.proving import prove_command
from twind_calibration.wiggling.posed_model import PosedModel
from twind_calibration.wiggling.wiggle_command import read_body

MODELS = Path(__file__).parents[2] / "data" / "models"
COMMANDS = {
    "poppy": (json.dumps(POPPY), ["--device", "AX-12=AX-12A"]),
    "arm": (json.dumps(LEROBOT), ["--device", "STS3215"]),
    "toddler": (json.dumps(TODDLER), ["--device", "XC330=XC330-T288"]),
    "thor": (ROBOTIS, []),
    "inter": (INTERBOTIX, ["--device", "waist=XM430-W350"]),
    "reachy": (REACHY, ["--device", "XL330-M288"]),
}


def new(folder: Path, name: str, text: str, *options: str) -> int:
    file = folder / f"{name}.txt"
    file.write_text(text)
    return main(["robot", "new", name, "--folder", str(folder / name), "--from", str(file), *options])


@pytest.mark.parametrize("name", COMMANDS)
def test_a_robot_of_each_software_passes_check_robot(name: str, tmp_path: Path) -> None:
    text, options = COMMANDS[name]
    assert new(tmp_path, name, text, *options) == 0
    file = tmp_path / name / f"{name}.yaml"
    assert main(["check", "robot", str(file)]) == 0
    robot = read_robot(file)
    assert "poses.rest" in robot.todo
    assert "support" in robot.todo


def test_what_no_source_states_is_open_and_refuses_live(tmp_path: Path) -> None:
    new(tmp_path, "thor", ROBOTIS)
    file = str(tmp_path / "thor" / "thor.yaml")
    assert read_robot(Path(file)).todo == (
        "support",
        "joints.r_sho.sign",
        "joints.r_sho.limits_rad",
        "poses.rest",
    )
    with pytest.raises(InvalidInput, match=r"joints\.r_sho\.sign"):
        describe(ConfigSources(mode="live", robot=file, ports=("/dev/null",)))
    describe(ConfigSources(mode="mirror", robot=file, ports=("/dev/null",)))


def test_virtual_servos_are_no_next_step_before_watchdogs_are_settled(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    new(tmp_path, "arm", json.dumps(LEROBOT), "--device", "STS3215")
    assert "finish --no-watchdog" in (told := capsys.readouterr().out) and "--virtual" not in told
    new(tmp_path, "thor", ROBOTIS)
    assert "twind --virtual --mode live" in capsys.readouterr().out


def test_the_next_steps_end_with_the_robot_itself_and_its_calibration(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    new(tmp_path, "arm", json.dumps(LEROBOT), "--device", "STS3215", "--support", "fixed", "--no-watchdog")
    file = tmp_path / "arm" / "arm.yaml"
    told = capsys.readouterr().out.splitlines()
    steps = [each.removeprefix("next:").partition("#")[0].strip() for each in told[-6:]]
    assert steps[2:] == [
        f"twind --mode mirror --robot {file} --port [BUS=]PORT",
        "twindctl calibrate sweep",
        "twindctl calibrate zero",
        f"twindctl robot finish --robot {file}",
    ]


def test_the_help_of_a_step_keeps_its_paragraphs(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["robot", "new", "--help"])
    assert "a model\n\nSources are" in capsys.readouterr().out


def test_answers_leave_fewer_items_open(tmp_path: Path) -> None:
    new(tmp_path, "arm", json.dumps(LEROBOT), "--device", "STS3215", "--support", "fixed", "--no-watchdog")
    assert read_robot(tmp_path / "arm" / "arm.yaml").todo == ("poses.rest",)


def test_counts_become_limits_about_the_middle_of_the_servo(tmp_path: Path) -> None:
    new(tmp_path, "arm", json.dumps(LEROBOT), "--device", "STS3215")
    (joint,) = read_robot(tmp_path / "arm" / "arm.yaml").joints
    assert joint.sign == -1
    assert joint.lower == pytest.approx(-(3200 - 2048) * 6.283185 / 4096, abs=1e-3)
    assert joint.upper == pytest.approx((2048 - 800) * 6.283185 / 4096, abs=1e-3)


def test_limits_in_counts_stay_open_until_the_sign_is_known(tmp_path: Path) -> None:
    new(tmp_path, "reachy", REACHY.replace("4000", "3000"), "--device", "XL330-M288")
    robot = read_robot(tmp_path / "reachy" / "reachy.yaml")
    assert "joints.body_rotation.sign" in robot.todo
    assert "joints.body_rotation.limits_rad" in robot.todo


def test_a_scan_completes_a_file_and_must_not_contradict_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = [
        {"id": 1, "baud": 1_000_000, "model": 777, "model_name": "STS3215"},
        {"id": 9, "baud": 1_000_000, "model": 777, "model_name": "STS3215"},
    ]
    monkeypatch.setattr(new_command, "scan_port", lambda port: found)
    assert new(tmp_path, "arm", json.dumps(LEROBOT), "--port", "desk=/dev/ttyX") == 0
    robot = read_robot(tmp_path / "arm" / "arm.yaml")
    assert {joint.name: (joint.bus, joint.id) for joint in robot.joints} == {
        "pan": ("desk", 1),
        "desk_9": ("desk", 9),
    }
    assert "id 9 on desk (STS3215) is no joint" in capsys.readouterr().out
    found[0]["model_name"] = "XL330-M288"
    poppy = json.loads(json.dumps(POPPY))
    poppy["motors"]["head_y"]["id"] = 1
    assert new(tmp_path, "poppy", json.dumps(poppy), "--port", "main=/dev/ttyX") == 1
    assert "head_y: device is 'AX-12' by poppy.txt, 'XL330-M288' by scan" in capsys.readouterr().err
    assert not (tmp_path / "poppy").exists()


@pytest.mark.parametrize(
    ("text", "options", "words"),
    [
        (json.dumps(LEROBOT), [], "say --device MODEL"),
        (json.dumps({"p n": LEROBOT["pan"]}), [], "name it with --joint 'p n=NAME'"),
        (json.dumps(LEROBOT), ["--device", "ST3215"], "no model of that name; nearest: STS3215"),
        (json.dumps(TODDLER), [], "XC330-M181"),
        (json.dumps(LEROBOT), ["--device", "STS3215", "--bus", "elbow=main"], "no source has a joint elbow"),
        ("{}", [], "no known format"),
    ],
)
def test_what_cannot_be_completed_is_refused_and_nothing_written(
    text: str, options: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert new(tmp_path, "arm", text, *options) in (1, 2)
    assert words in capsys.readouterr().err
    assert not (tmp_path / "arm").exists()


def test_a_folder_that_exists_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "arm").mkdir()
    assert new(tmp_path, "arm", json.dumps(LEROBOT), "--device", "STS3215") == 1
    assert "exists" in capsys.readouterr().err


def test_a_urdf_with_ros2_control_becomes_a_robot_with_bodies(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [
        "robot",
        "new",
        "pantilt",
        "--folder",
        str(tmp_path / "p"),
        "--model",
        str(MODELS / "pantilt.urdf"),
    ]
    assert main(words) == 1
    assert "joint pan, tilt: no source states its model" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
    assert main([*words, "--device", "XL330-M288", "--support", "fixed"]) == 0
    robot = read_robot(tmp_path / "p" / "pantilt.yaml")
    assert {joint.name: (joint.id, joint.bus, joint.lower, joint.upper) for joint in robot.joints} == {
        "pan": (1, "ttyUSB0", -1.47, 1.47),
        "tilt": (2, "ttyUSB0", -0.77, 0.77),
    }
    assert not robot.gate.collision.bodiless
    assert robot.todo == ("joints.pan.sign", "joints.tilt.sign", "poses.rest")
    assert main(["check", "robot", str(robot.path)]) == 0


def test_of_limits_of_two_sources_the_tighter_one_stays(tmp_path: Path) -> None:
    motors = {"m1": {**POPPY["motors"]["head_y"], "angle_limit": [-100, 20], "type": "XL330-M288"}}
    file = tmp_path / "motors.json"
    file.write_text(json.dumps({**POPPY, "motors": motors}))
    model = str(MODELS / "pantilt.xml")
    words = ["--from", str(file), "--model", model, "--joint", "m1=pan", "--folder", str(tmp_path / "p")]
    assert main(["robot", "new", "pantilt", *words]) == 0
    robot = read_robot(tmp_path / "p" / "pantilt.yaml")
    (pan,) = robot.joints
    assert (pan.lower, pan.upper) == pytest.approx((-1.47, math.radians(20)), abs=1e-5)
    assert robot.passive == ("tilt",)


def test_a_motor_that_is_no_joint_of_the_model_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--model", str(MODELS / "pantilt.xml"), "--device", "STS3215"]
    assert new(tmp_path, "arm", json.dumps({"pam": LEROBOT["pan"]}), *words) == 1
    assert "joint pam" in (told := capsys.readouterr().err)
    assert "nearest: pan" in told
    assert main(["robot", "new", "bare", "--folder", str(tmp_path / "bare"), *words]) == 1
    assert "no source has ids" in capsys.readouterr().err


def test_mode_and_rate_of_a_file_are_taken_over(tmp_path: Path) -> None:
    new(tmp_path, "toddler", json.dumps(TODDLER), "--device", "XC330=XC330-T288")
    robot = read_robot(tmp_path / "toddler" / "toddler.yaml")
    assert robot.joints[0].mode == "extended_position"
    assert robot.buses[0].baud == 2_000_000


def poppy_of(controllers: dict[str, object]) -> str:
    motors = {
        name: POPPY["motors"]["head_y"] | {"id": number, "type": model}
        for number, (name, model) in enumerate((("l_y", "MX-64"), ("l_x", "MX-64"), ("head", "AX-12A")), 1)
    }
    return json.dumps({"controllers": controllers, "motors": motors})


def test_servos_of_one_bus_speak_the_protocol_of_their_controller(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert new(tmp_path, "poppy", poppy_of({"c": {"port": "auto"}})) == 0
    robot = read_robot(tmp_path / "poppy" / "poppy.yaml")
    assert [joint.type.device for joint in robot.joints] == ["MX-64(1.0)", "MX-64(1.0)", "AX-12A"]
    assert new(tmp_path, "mixed", poppy_of({"c": {"port": "auto", "protocol": 2}})) == 1
    assert "MX-64 need kind dynamixel2; AX-12A need kind dynamixel1; say --device" in capsys.readouterr().err


def test_joints_without_a_bus_are_named_in_one_line_and_answered_by_a_pattern(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = poppy_of({"c": {"port": "x"}, "d": {"port": "y"}})
    assert new(tmp_path, "poppy", text, "--bus", "head=d") == 1
    assert "joint l_y, l_x: on which of the buses c, d? Say --bus JOINT=BUS" in capsys.readouterr().err
    assert new(tmp_path, "poppy", text, "--bus", "head=d", "--bus", "l_*=c") == 0
    assert [joint.bus for joint in read_robot(tmp_path / "poppy" / "poppy.yaml").joints] == ["c", "c", "d"]


def test_two_files_of_equal_names_become_two_sides(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, number in (("one", 1), ("two", 2)):
        arm = {"Elbow Joint": LEROBOT["pan"] | {"id": number}, "pan": LEROBOT["pan"] | {"id": number + 4}}
        (tmp_path / f"{name}.json").write_text(json.dumps(arm))
    words = ["robot", "new", "pair", "--folder", str(tmp_path / "pair"), "--device", "STS3215"]
    files = [tmp_path / "one.json", tmp_path / "two.json"]
    both = ["--from", str(files[0]), "--from", str(files[1]), "--joint", "Elbow Joint=elbow"]
    assert main([*words, *both]) == 1
    assert "--from left_=FILE" in capsys.readouterr().err
    words += ["--from", f"l_={files[0]}", "--from", f"r_={files[1]}"]
    words += ["--joint", "l_Elbow Joint=l_elbow", "--joint", "r_Elbow Joint=r_elbow"]
    assert main([*words, "--bus", "l_*=left", "--bus", "r_*=right"]) == 0
    robot = read_robot(tmp_path / "pair" / "pair.yaml")
    assert [(joint.name, joint.bus, joint.id) for joint in robot.joints] == [
        ("l_elbow", "left", 1),
        ("l_pan", "left", 5),
        ("r_elbow", "right", 2),
        ("r_pan", "right", 6),
    ]


def test_parameters_of_ros2_control_that_are_not_read_are_reported_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mode = '<param name="Operating Mode">5</param></gpio>'
    model = tmp_path / "pantilt.urdf"
    model.write_text((MODELS / "pantilt.urdf").read_text().replace("</gpio>", mode))
    words = ["robot", "new", "p", "--folder", str(tmp_path / "p"), "--model", str(model)]
    assert main([*words, "--device", "XL330-M288"]) == 0
    told = capsys.readouterr().out
    assert told.count("Operating Mode") == 1 and "not read: Operating Mode\n" in told


def test_a_travel_of_more_than_a_turn_takes_a_mode_of_several(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = tmp_path / "pantilt.urdf"
    text = (MODELS / "pantilt.urdf").read_text()
    model.write_text(text.replace("1, 0, 0, 1", "0.25, 0, 0, 1"))  # a gear of 4 on a travel of half a turn
    words = ["robot", "new", "p", "--folder", str(tmp_path / "p"), "--model", str(model)]
    assert main([*words, "--device", "XL330-M288"]) == 0
    assert "joint pan: its travel is 1.87 turns of its servo" in capsys.readouterr().out
    modes = [joint.mode for joint in read_robot(tmp_path / "p" / "p.yaml").joints]
    assert modes == ["extended_position", "position"]


def test_wiggle_compares_no_loads_of_a_robot_without_bodies(tmp_path: Path) -> None:
    new(tmp_path, "arm", json.dumps(LEROBOT), "--device", "STS3215")
    robot = read_robot(tmp_path / "arm" / "arm.yaml")
    body, why = read_body({"path": str(robot.path), "text_sha256": robot.text_sha256})
    assert body is None and "describes no bodies" in why


def test_no_joint_of_a_robot_without_bodies_is_moved_for_a_proof(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    new(tmp_path, "arm", json.dumps(LEROBOT), "--device", "STS3215")
    robot = read_robot(tmp_path / "arm" / "arm.yaml")
    daemon = FakeDaemon(robot, tmp_path / "arm.yaml", calibration(make_spec(robot)))
    stand_in(monkeypatch, daemon, prove_command)
    assert main(["calibrate", "prove", "pan", "--base", "upright", "--yes"]) == 1
    assert "describes no bodies (collision.bodies: none)" in capsys.readouterr().err
    assert set(daemon.asked) == {"GetRobot", "GetParameters"}
    assert main(["calibrate", "prove", "--plan", "--robot", str(robot.path)]) == 1
    assert "describes no bodies" in capsys.readouterr().err


def test_of_a_model_without_geometry_only_the_turn_is_described(tmp_path: Path) -> None:
    new(tmp_path, "arm", json.dumps(LEROBOT), "--device", "STS3215")
    robot = read_robot(tmp_path / "arm" / "arm.yaml")
    judged = replace(robot.gate, collision=replace(robot.gate.collision, bodiless=False))
    body = PosedModel(replace(robot, gate=judged))
    assert " turns " in body.looks_like(np.zeros(len(robot.names)), 0, 0.1)


def test_what_is_no_motor_is_left_out_with_a_note(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    new(tmp_path, "thor", ROBOTIS)
    assert "note: thor.txt: open-cr is left out: sensor" in capsys.readouterr().out
    assert read_robot(tmp_path / "thor" / "thor.yaml").names == ("r_sho",)
    new(tmp_path, "toddler", json.dumps(TODDLER), "--device", "XC330=XC330-T288")
    assert "note: toddler.txt: neck_driven is left out: is_passive is True" in capsys.readouterr().out


def test_joints_are_left_out_by_patterns(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = json.dumps({f"{name}_grip": LEROBOT["pan"] | {"id": 2} for name in ("l", "r")} | LEROBOT)
    assert new(tmp_path, "arm", text, "--device", "STS3215", "--without", "hand_*") == 2
    assert "no source has a joint hand_*: l_grip, r_grip, pan" in capsys.readouterr().err
    assert new(tmp_path, "arm", text, "--device", "STS3215", "--without", "*_grip") == 0
    assert read_robot(tmp_path / "arm" / "arm.yaml").names == ("pan",)


def test_a_sliding_joint_of_a_model_is_left_out_by_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = tmp_path / "gripper.urdf"
    model.write_text(
        (MODELS / "pantilt.urdf")
        .read_text()
        .replace('<joint name="tilt" type="revolute">', '<joint name="tilt" type="prismatic">')
    )
    words = ["robot", "new", "grip", "--folder", str(tmp_path / "g"), "--model", str(model)]
    words += ["--device", "XL330-M288"]
    assert main(words) == 1
    assert "is a slide, no hinge, of pantilt.xml; leave it out (--without tilt)" in capsys.readouterr().err
    assert main([*words, "--without", "tilt"]) == 0
    assert read_robot(tmp_path / "g" / "grip.yaml").passive == ("tilt",)


def test_a_trouble_of_the_line_counts_where_no_device_is_found() -> None:
    found = {"id": 1, "baud": 1_000_000, "model_name": "STS3215", "trouble": ""}
    other = {"baud": 1_000_000, "trouble": "devices answer protocol 1.0"}
    assert devices_of([other, found], "", "/dev/x") == [found]
    with pytest.raises(Rejected, match=r"protocol 1\.0; correct it and scan again"):
        devices_of([other], "", "/dev/x")
    with pytest.raises(Rejected, match="id 1: two devices"):
        devices_of([found | {"trouble": "two devices have this id"}], "", "/dev/x")
    with pytest.raises(Rejected, match="no device answers"):
        devices_of([], "", "/dev/x")


def test_an_id_that_answers_on_two_buses_is_given_to_no_joint_by_guess(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = [{"id": 1, "baud": 1_000_000, "model_name": "STS3215"}]
    monkeypatch.setattr(new_command, "scan_port", lambda port: found)
    ports = ["--port", "left=/dev/x", "--port", "right=/dev/y"]
    assert new(tmp_path, "arm", json.dumps(LEROBOT), *ports) == 1
    assert "joint pan: id 1 answers on left and right: say --bus pan=BUS" in capsys.readouterr().err
    assert new(tmp_path, "arm", json.dumps(LEROBOT), *ports, "--bus", "pan=right") == 0
    robot = read_robot(tmp_path / "arm" / "arm.yaml")
    assert {joint.name: joint.bus for joint in robot.joints} == {"pan": "right", "left_1": "left"}
