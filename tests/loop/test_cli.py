"""The command line of `twind`: which port is whose, why live is denied, and what the exit code says."""

import os
import re
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.support.cli_rig import settings
from twind import cli
from twind.cli import FAILED, USAGE, wrong_groups
from twind.config.config_files import ConfigSources, bus_ports, describe, live_denied, refuse_wrong
from twind.config.robot_file import load_robot
from twind.config.yaml_tree import ConfigError
from twind.exceptions import InvalidInput, OperationFailed, TwindError
from twind.robot.finding import ReasonCode
from twind.robot.modes import Mode
from twind.virtual.virtual_robot_spec import make_spec, save
from twind_drivers.bus import PortError, PortErrorCause

TWO = ["legs", "arms"]


# ------------------------------------------------------------------------------------- ports


def test_a_bare_port_is_that_of_the_only_bus() -> None:
    assert bus_ports(settings("/dev/ttyUSB0"), ["main"], {"main": None}) == {"main": "/dev/ttyUSB0"}


def test_two_buses_on_one_port_are_refused_also_by_a_link_to_it(tmp_path: Path) -> None:
    link = tmp_path / "legs"
    link.symlink_to("/dev/ttyUSB0")
    for given in (["legs=/dev/ttyUSB0", "arms=/dev/ttyUSB0"], [f"legs={link}"]):
        with pytest.raises(InvalidInput, match="buses legs and arms have the same port /dev/ttyUSB0"):
            bus_ports(settings(*given), TWO, {"legs": None, "arms": "/dev/ttyUSB0"})


def test_a_bare_port_of_several_buses_is_refused_with_what_to_type() -> None:
    with pytest.raises(InvalidInput, match="2 buses, say which: --port legs=PORT --port arms=PORT"):
        bus_ports(settings("/dev/ttyUSB0"), TWO, dict.fromkeys(TWO))


def test_each_bus_of_several_has_its_port() -> None:
    named = settings("arms=/dev/ttyUSB1", "legs=/dev/ttyUSB0")
    assert bus_ports(named, TWO, dict.fromkeys(TWO)) == {"legs": "/dev/ttyUSB0", "arms": "/dev/ttyUSB1"}


def test_a_bus_that_the_robot_does_not_have_is_answered_with_those_it_has() -> None:
    with pytest.raises(InvalidInput, match="no bus 'leg'; the buses of this robot: legs, arms"):
        bus_ports(settings("leg=/dev/ttyUSB0"), TWO, dict.fromkeys(TWO))


def test_the_command_line_wins_over_the_settings_and_they_over_the_robot_file() -> None:
    described = {"legs": "/dev/robot_0", "arms": "/dev/robot_1"}
    assert bus_ports(settings(), TWO, described) == described
    named = {"arms": "/dev/file_1", "legs": "/dev/file_0"}
    assert bus_ports(settings(file=named), TWO, described) == named
    both = settings("legs=/dev/line", file=named)
    assert bus_ports(both, TWO, described) == {"legs": "/dev/line", "arms": "/dev/file_1"}
    assert bus_ports(settings("/dev/line", file={"main": "/dev/file"}), ["main"], {"main": None}) == {
        "main": "/dev/line"
    }


def test_a_relative_port_becomes_absolute(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert bus_ports(settings("ports/main"), ["main"], {"main": None}) == {
        "main": str(tmp_path / "ports/main")
    }
    can = {"main": "can:socketcan:can0"}
    assert bus_ports(settings(), ["main"], can) == can


def test_a_bus_without_a_port_stays_without() -> None:
    ports = bus_ports(settings("legs=/dev/ttyUSB0"), TWO, dict.fromkeys(TWO))
    assert ports == {"legs": "/dev/ttyUSB0", "arms": None}


def test_the_settings_are_not_changed_by_being_read() -> None:
    given = settings("/dev/ttyUSB0")
    described = {"main": None}
    bus_ports(given, ["main"], described)
    assert dict(given.ports) == {"": "/dev/ttyUSB0"}
    assert described == {"main": None}


@pytest.mark.parametrize(
    ("ports", "message"),
    [
        (["a", "b"], "given twice"),
        (["main=a", "main=b"], "for bus main twice"),
        ([""], "empty"),
        (["can:can0"], "a CAN port is can:INTERFACE:CHANNEL"),
        (["main=can::can0"], "a CAN port is can:INTERFACE:CHANNEL"),
    ],
)
def test_a_port_that_cannot_be_meant_is_refused(ports: Sequence[str], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        settings(*ports)


def test_a_path_with_an_equals_sign_is_a_path() -> None:
    by_id = "/dev/serial/by-id/usb-FTDI=1"
    assert bus_ports(settings(by_id), ["main"], {"main": None}) == {"main": by_id}


@pytest.mark.parametrize("given", ["can:slcan:/dev/ttyACM0", "can:slcan:/dev/by=id", "can:socketcan:can0"])
def test_a_can_port_may_be_given_bare_or_for_a_bus(given: str) -> None:
    assert bus_ports(settings(given), ["main"], {"main": None}) == {"main": given}
    assert bus_ports(settings(f"legs={given}"), TWO, dict.fromkeys(TWO)) == {"legs": given, "arms": None}


@pytest.mark.parametrize(
    ("bus", "port", "message"),
    [
        (
            "l_leg",
            "/dev/ttyACM0",
            "port of bus l_leg: /dev/ttyACM0: a bus of kind can needs can:INTERFACE:CHANN",
        ),
        (
            "upper",
            "can:socketcan:can0",
            "port of bus upper: can:socketcan:can0: a bus of kind dynamixel2 needs",
        ),
    ],
)
def test_a_port_of_the_other_kind_is_refused_with_what_is_right(bus: str, port: str, message: str) -> None:
    robot = load_robot("h24-mixed")
    refuse_wrong(robot, {"upper": "/dev/ttyUSB0", "l_leg": "can:slcan:/dev/ttyACM0", "r_leg": None})
    with pytest.raises(InvalidInput, match=message):
        refuse_wrong(robot, {bus: port})


# ------------------------------------------------------------------------------------- live


USUAL = Path("/var/lib/twind/calibration/h24.yaml")


def test_live_needs_a_port_for_every_bus() -> None:
    ports = {"legs": "/dev/ttyUSB0", "arms": None}
    denied = live_denied("h24", ports, USUAL, calibrated=True)
    assert denied is not None
    assert denied.code is ReasonCode.HW_DISCONNECTED
    assert "--port arms=PORT" in denied.message


def test_live_needs_a_calibration() -> None:
    denied = live_denied("h24", {"main": "/dev/ttyUSB0"}, USUAL, calibrated=False)
    assert denied is not None
    assert denied.code is ReasonCode.CALIB_MISSING
    assert "--calibration FILE" in denied.message
    assert str(USUAL) in denied.message  # where to put it
    (told,) = re.findall(r"how to make one: (\S+)$", denied.message)
    assert Path(told).read_text().startswith("# Calibration")


def test_with_both_nothing_stands_in_the_way() -> None:
    assert live_denied("h24", {"main": "/dev/ttyUSB0"}, USUAL, calibrated=True) is None


# ------------------------------------------------------------------------------------- exit codes


@pytest.fixture(autouse=True)
def nowhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No settings, calibration or folder of this machine."""
    for key in ("XDG_CONFIG_HOME", "XDG_STATE_HOME", "XDG_RUNTIME_DIR", "HOME"):
        monkeypatch.setenv(key, str(tmp_path / key))
    own = os.geteuid() or 12345  # a folder of root's is as good as one of ours
    monkeypatch.setattr("os.geteuid", lambda: own)
    monkeypatch.setattr("faulthandler.enable", lambda fd: None)  # the test run has its own


def ended(capfd: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    """Exit code and standard error."""
    try:
        code: Any = cli.main(list(arguments))
    except SystemExit as end:  # argparse
        code = end.code
    return code, capfd.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--mode", "fly"], "invalid choice: 'fly'"),
        (["--fast"], "unrecognized arguments: --fast"),
        (["--rate", "quick"], "invalid float value"),
        (["--rate", "5000"], "outside 10 to 1000 Hz"),
        (["--rate", "nan"], "outside 10 to 1000 Hz"),
        (["--rate", "1000"], "main"),
        (["--config", "/nowhere/twind.yaml"], "/nowhere/twind.yaml"),
        (["--robot", "h25"], "h24"),
        (["--robot", "h24-split", "--port", "/dev/ttyUSB0"], "2 buses"),
        (["--port", "mian=/dev/ttyUSB0"], "no bus 'mian'"),
        (["--calibration", "/nowhere/c.yaml"], "/nowhere/c.yaml"),
        (["--mode", "live"], "--port main=PORT"),
        (["--mode", "live", "--port", "/dev/ttyUSB0"], "--calibration FILE"),
    ],
)
def test_an_invalid_command_line_exits_with_two_and_the_reason(
    capfd: pytest.CaptureFixture[str], tmp_path: Path, arguments: list[str], message: str
) -> None:
    code, said = ended(capfd, "--socket", str(tmp_path / "run"), *arguments)
    assert code == USAGE == 2
    assert message in said
    assert "Traceback" not in said
    assert not (tmp_path / "run").exists()  # nothing was begun


def test_a_port_that_cannot_be_had_ends_with_1_and_gives_the_sockets_back(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("")
    code, said = ended(capfd, "--socket", str(tmp_path / "run"), "--port", str(tmp_path / "file"))
    assert code == FAILED == 1
    assert "not a character device" in said
    again, said = ended(capfd, "--socket", str(tmp_path / "run"), "--port", str(tmp_path / "file"))
    assert (again, "another twind" in said) == (FAILED, False)


def test_a_folder_that_cannot_be_ends_with_1(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    code, said = ended(capfd, "--mode", "sim", "--socket", str(tmp_path / "file"))
    assert code == FAILED
    assert "control.sock" in said
    assert "--socket DIR" in said


def test_a_virtual_robot_process_gets_no_inherited_socket_variables(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[list[str]] = []

    class Child:
        def __init__(self, robot: str) -> None:
            seen.append([key for key in os.environ if key.startswith("LISTEN_")])
            raise OperationFailed(f"{robot}: far enough")

    monkeypatch.setattr(cli, "VirtualRobotProcess", Child)
    for key, value in (("FDS", "2"), ("PID", "1"), ("FDNAMES", "control:observe")):
        monkeypatch.setenv(f"LISTEN_{key}", value)
    code, said = ended(capfd, "--virtual")
    assert (code, seen) == (FAILED, [[]])
    assert "h24: far enough" in said


def test_the_order_socket_of_a_virtual_robot_is_printed_at_start(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Child:
        def __init__(self, robot: str) -> None:
            self.faults = Path("/x/faults.sock")
            self.calibration = Path("/x/none.yaml")
            self.ports = {}
            self.power = {}

        def __enter__(self) -> Any:
            return self

        def __exit__(self, *_why: object) -> None: ...

    monkeypatch.setattr(cli, "VirtualRobotProcess", Child)
    code, said = ended(capfd, "--virtual")
    assert code == USAGE and "none.yaml" in said  # no calibration of its own: far enough
    assert "takes orders" in said.splitlines()[0] and said.splitlines()[0].endswith("at /x/faults.sock")


def test_a_socket_without_its_group_is_reported_with_the_remedy() -> None:
    assert wrong_groups({"control": "twind-operator", "observe": "twind-observe"}) == []
    (told,) = wrong_groups({"control": "root", "observe": "twind-observe"})
    assert "control.sock is for group root, not twind-operator" in told
    assert "groupadd -r twind-operator" in told


@pytest.mark.parametrize(
    ("mode", "virtual", "folder"),
    [
        ("live", False, "flight"),
        ("mirror", False, "flight"),
        ("sim", False, "flight/sim"),
        ("sim", True, "flight/virtual"),
        ("live", True, "flight/virtual"),
    ],
)
def test_a_robot_that_is_none_writes_its_faults_beside_those_of_the_real_one(
    tmp_path: Path, mode: str, virtual: bool, folder: str
) -> None:
    settings: Any = SimpleNamespace(mode=mode, state_dir=tmp_path)
    assert cli.flight_folder(settings, virtual=virtual) == tmp_path / folder


def test_the_fail_safe_report_is_written_without_realtime_and_its_failure_ends_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    done: list[str] = []

    def broken(*_: Any, **__: Any) -> None:
        done.append("briefing")
        raise UnicodeEncodeError("utf-8", "\udc80", 0, 1, "surrogates not allowed")

    monkeypatch.setattr(cli.realtime, "drop_realtime", lambda: done.append("leave"))
    monkeypatch.setattr(cli.assembly, "briefing", broken)
    settings = SimpleNamespace(mode="live", state_dir=tmp_path, parameters=dict)
    described: Any = SimpleNamespace(settings=settings, rate_hz=100.0, files={})
    nobody: Any = None
    cli.save_failsafe_recording(described, nobody, nobody, "live")
    assert done == ["leave", "briefing"]
    assert "could not be written down: UnicodeEncodeError" in capfd.readouterr().err


@pytest.mark.parametrize("where", ["describe", "run_loop"])
def test_a_fail_safe_that_ends_by_an_exception_says_how_the_robot_is_left(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], where: str
) -> None:
    """Its recording is written before it ends."""
    done: list[str] = []

    def broken(*_: Any) -> None:
        raise ZeroDivisionError("a defect")

    loop: Any = SimpleNamespace(
        condition=SimpleNamespace(mode=Mode.LIVE),
        commands=SimpleNamespace(release=None),
        identity=None,
        reports=SimpleNamespace(event=lambda *_: None),
        procedures=SimpleNamespace(beside=lambda _: None),
        parts=SimpleNamespace(period=0.01),
        hardware=SimpleNamespace(ports=[]),
        close=lambda: done.append("close"),
    )
    described = SimpleNamespace(
        settings=SimpleNamespace(mode="live"), ports={"main": "/dev/x"}, robot=None, rate_hz=100.0
    )
    monkeypatch.setattr(cli.signal, "signal", lambda *_: None)
    monkeypatch.setattr(cli, "describe", lambda _: described)
    monkeypatch.setattr(cli, "_made", lambda _: (None, SimpleNamespace(refuse_taken=lambda: None)))
    monkeypatch.setattr(cli.bus_tap, "recorder", lambda *_: SimpleNamespace(link=None))
    monkeypatch.setattr(cli, "_loop", lambda *_: loop)
    monkeypatch.setattr(cli, "save_failsafe_recording", lambda *_: done.append("save"))
    monkeypatch.setattr(cli, where, broken)
    with pytest.raises(ZeroDivisionError):
        cli.main(["--failsafe"])
    assert "support it and switch its power off" in capfd.readouterr().err
    assert done == (["close", "save"] if where == "run_loop" else [])


def test_the_version_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        cli.main(["--version"])
    assert end.value.code == 0
    assert capsys.readouterr().out.startswith("twind ")


# ------------------------------------------------------------------------------------- instances


def test_an_instance_has_its_own_settings_robots_and_sockets_and_the_state_of_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As `twind@arm.service` starts it: user, folders and environment of the plain service."""
    etc = tmp_path / "etc" / "twind"
    state = tmp_path / "state"
    (etc / "robots").mkdir(parents=True)
    (state / "calibration").mkdir(parents=True)
    source = load_robot("h24").path.parent
    (etc / "robots" / "h24.xml").write_text((source / "h24.xml").read_text())
    text = (source / "h24.yaml").read_text()
    assert "name: h24\n" in text
    (etc / "robots" / "arm.yaml").write_text(text.replace("name: h24\n", "name: arm\n"))
    (etc / "arm.yaml").write_text("robot: arm\nindividual: arm-7\nmode: sim\n")
    (etc / "twind.yaml").write_text("robot: nobody\n")  # of the plain service
    save(make_spec(load_robot("arm", (etc / "robots",))), state / "calibration" / "arm-7.yaml")
    monkeypatch.setattr("os.geteuid", lambda: 4711)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "etc"))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "run"))
    monkeypatch.setenv("STATE_DIRECTORY", str(state))
    found = describe(ConfigSources(config=str(etc / "arm.yaml"), socket=str(tmp_path / "run/twind/arm")))
    assert found.robot.name == "arm"
    assert found.robot.path == etc / "robots" / "arm.yaml"
    assert found.calibration is not None
    assert found.settings.socket_dir == tmp_path / "run" / "twind" / "arm"
    assert ConfigSources(config=str(etc / "arm.yaml")).settings().socket_dir == tmp_path / "run" / "twind"


@pytest.mark.parametrize(
    "error",
    [InvalidInput("a defect"), PortError("main", "a defect", PortErrorCause.IN_USE)],
)
def test_an_error_of_a_running_loop_is_a_defect_and_not_one_of_usage_or_of_a_port(error: TwindError) -> None:
    def run() -> None:
        raise error

    loop: Any = SimpleNamespace(run=run)
    with pytest.raises(RuntimeError, match="a defect") as failed:
        cli.run_loop(loop)
    assert not isinstance(failed.value, TwindError)


@pytest.mark.parametrize(("mode", "remedy"), [(Mode.MIRROR, True), (Mode.SIM, False)])
def test_a_bus_without_a_port_is_logged_with_the_option_that_names_one(mode: Mode, remedy: bool) -> None:
    ports = [SimpleNamespace(name="main", where=None)]
    loop: Any = SimpleNamespace(
        condition=SimpleNamespace(mode=mode),
        parts=SimpleNamespace(period=0.01),
        hardware=SimpleNamespace(ports=ports),
    )
    text = cli.start_text(loop)
    assert text.startswith(f"mode {mode.value}, 100 Hz, main on no port")
    assert ("--port main=PORT" in text) == remedy
