"""`twindctl adopt` by real bytes on a pseudo-terminal: `twind-virtual` with a servo as delivered."""

import argparse
import io
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.support.adoption_rig import robot_of
from tests.support.single_answer import answering
from twind.command_line.verb import Rejected
from twind.ctl.ctl_main import main
from twind.ctl.instance_paths import sockets_of, stop
from twind_calibration.robot_description import read
from twind_drivers.clock import MonotonicClock
from twind_drivers.dynamixel.dynamixel_tools import PROTOCOL
from twind_drivers.ports.serial_port import SerialTransport
from twind_drivers.servo_tools.adoption.adopt_command import status_at
from twind_drivers.servo_tools.prober import PortProber


@contextmanager
def servo(folder: Path, *options: str) -> Iterator[str]:
    """The port of a bus with one servo."""
    command = [sys.executable, "-m", "twind.virtual", "--servo", "main:1:XM430-W350", *options]
    command += ["--link", str(folder / "ports")]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdin is not None and process.stdout is not None
    try:
        while (line := process.stdout.readline()) != b"ready\n":
            assert line, "twind-virtual did not start"
        yield str(folder / "ports/main")
    finally:
        process.stdin.close()
        process.wait(10)
        process.stdout.close()


@pytest.fixture(scope="module")
def delivered(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The port of a servo as delivered, for tests that write nothing."""
    with servo(tmp_path_factory.mktemp("delivered")) as port:
        yield port


@pytest.fixture
def words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Options for a robot with two joints, for a user without a daemon."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    robot = robot_of(tmp_path, {"elbow": 1, "wrist": 7})
    return ["--socket", str(tmp_path / "none"), "adopt", "--robot", str(robot.path)]


def test_a_servo_as_delivered_answers_at_its_place_afterwards(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with servo(tmp_path) as port:
        assert main([*words, "wrist", "--port", port, "--yes"]) == 0
        said = capsys.readouterr()
        transport = SerialTransport(port, 1_000_000)
        asked = PortProber(transport, MonotonicClock(), 1_000_000, PROTOCOL)
        assert [each.id for each in asked.ping(7).statuses] == [7]
        assert asked.ping(1).statuses == []
        transport.close()
    assert "becomes wrist: id 7 at 1000000 baud on bus main" in said.err
    assert said.out.startswith("wrist has its servo: id 7 at 1000000 baud on bus main, torque off\n")
    assert "wrist is not calibrated: live refuses to arm (CALIB_MISSING)" in said.out


def test_the_suggested_adopt_command_names_the_same_robot(
    words: list[str], delivered: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*words, "--port", delivered, "--dry-run"]) == 1
    again = f"`twindctl --socket {words[1]} adopt --robot {words[4]} --port {delivered} JOINT`"
    assert f"Say which: {again}" in capsys.readouterr().err


class Terminal(io.StringIO):
    """Standard input that a person types on."""

    def isatty(self) -> bool:
        return True


def test_without_a_yes_nothing_is_written(
    words: list[str], delivered: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stdin", Terminal("no\n"))
    assert main([*words, "wrist", "--port", delivered]) == 1
    said = capsys.readouterr().err
    assert "write this? [y/N] " in said and "nothing was written" in said
    assert main([*words, "wrist", "--port", delivered, "--json", "--dry-run"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["state"] == "planned"
    assert told["from"] == {"id": 1, "baud": 57_600}
    assert {"register": "return_delay_time", "address": 9, "now": 250, "then": 10} in told["registers"]


def test_a_port_in_use_is_refused_and_its_holder_named(
    words: list[str], delivered: str, capsys: pytest.CaptureFixture[str]
) -> None:
    held = SerialTransport(delivered, 1_000_000)
    assert main([*words, "wrist", "--port", delivered, "--yes"]) == 1
    held.close()
    said = capsys.readouterr().err
    assert f"in use by pid {os.getpid()}" in said
    assert "stop the daemon (`sudo systemctl stop twind twind-control.socket twind-observe.socket`" in said


def test_a_daemon_that_has_lost_this_port_is_to_be_stopped_too(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    port = str(tmp_path / "ttyUSB0")
    buses = [{"name": "main", "port": port, "connected": False}]
    words[1] = str(tmp_path)
    with answering(tmp_path / "observe.sock", {"status": {"mode": "live", "buses": buses}}):
        assert main([*words, "wrist", "--port", port, "--yes"]) == 1
    assert "has this port: stop the daemon" in capsys.readouterr().err


@contextmanager
def mute(path: Path) -> Iterator[None]:
    """A daemon's socket that takes everybody and says nothing."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as listener:
        listener.bind(str(path))
        listener.listen()
        yield


def test_a_daemon_that_does_not_answer_may_have_the_port(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("twind_drivers.servo_tools.adoption.adopt_command.PATIENCE", 0.3)
    words[1] = str(tmp_path)
    with mute(tmp_path / "control.sock"):
        assert main([*words, "wrist", "--port", str(tmp_path / "ttyUSB0"), "--yes"]) == 1
    said = capsys.readouterr().err
    assert f"{tmp_path}/control.sock: a daemon listens there and does not say which ports it has" in said
    assert "twind-control.socket" in said


@contextmanager
def permitted_little() -> Iterator[None]:
    """As a user to whom files say no, which they never do to root."""
    uid = os.geteuid()
    if uid == 0:
        os.seteuid(65_534)
    try:
        yield
    finally:
        os.seteuid(uid)


def test_a_daemon_that_may_not_be_asked_may_have_the_port(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with tempfile.TemporaryDirectory(dir="/tmp") as name, mute(Path(name, "observe.sock")):
        os.chmod(name, 0o755)
        os.chmod(Path(name, "observe.sock"), 0)
        with permitted_little(), pytest.raises(Rejected, match=r"permission denied: .* try with sudo"):
            status_at(name)
    assert status_at(name) is None  # it is gone
    with tempfile.TemporaryDirectory(dir="/tmp") as name:
        left = Path(name, "control.sock")
        with mute(left):
            pass
        assert left.is_socket() and status_at(name) is None  # left by one that was killed: nobody listens


def test_an_instance_is_found_by_its_settings_and_by_its_name(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = tmp_path / "arm.yaml"
    settings.write_text(f"robot: {tmp_path / 'bench.yaml'}\nports: {{main: /dev/ttyARM}}\n")
    monkeypatch.setattr("twind_calibration.robot_description.SERVICE", tmp_path / "twind.yaml")
    options = argparse.Namespace(config=str(settings), socket=None, robot=None, calibration=None, port=[])
    assert str(read(options).sockets) == "/run/twind/arm"
    options.config = None
    options.socket = "/run/twind/arm"
    assert read(options).port("main") == "/dev/ttyARM"
    assert stop(str(read(options).sockets)) == (
        "sudo systemctl stop twind@arm twind-control@arm.socket twind-observe@arm.socket"
    )


@pytest.mark.parametrize(
    ("config", "socket_dir", "listens"),
    [
        ("/etc/twind/twind.yaml", "/run/twind", "/run/twind"),
        ("/etc/twind/../twind/arm.yaml", "/run/twind", "/run/twind/arm"),
        ("/etc/twind/arm.yaml", "/srv/sockets", "/srv/sockets"),  # its own settings say where
        ("/home/one/arm.yaml", "/run/twind", "/run/twind"),
        (None, "/run/user/1000/twind", "/run/user/1000/twind"),
    ],
)
def test_the_socket_folder_of_a_daemon_follows_from_its_settings(
    config: str | None, socket_dir: str, listens: str
) -> None:
    assert sockets_of(config, socket_dir, Path("/etc/twind")) == listens


@pytest.mark.parametrize(
    ("place", "units"),
    [
        (None, "twind twind-control.socket twind-observe.socket"),
        ("/run/twind", "twind twind-control.socket twind-observe.socket"),
        ("/run/twind/control.sock", "twind twind-control.socket twind-observe.socket"),
        ("/run/twind/arm/observe.sock", "twind@arm twind-control@arm.socket twind-observe@arm.socket"),
        ("/run/user/1000/twind", "twind twind-control.socket twind-observe.socket"),
    ],
)
def test_a_service_is_stopped_with_the_sockets_that_would_start_it(place: str | None, units: str) -> None:
    assert stop(place) == f"sudo systemctl stop {units}"


@pytest.mark.parametrize(
    ("more", "code", "message"),
    [
        (["wrist", "--port", "/dev/null", "--json"], 2, "--json asks no question: add --yes"),
        (["wrist", "--port", "/dev/null"], 2, "standard input is no terminal; add --yes"),
        (["wrist", "--yes"], 2, "bus main of bench has no port: say --port main=PORT"),
        (["wrist", "--yes", "--port", "left=/dev/null"], 2, "no bus 'left'; the buses of this robot: main"),
        (["thumb", "--yes"], 1, "bench has no joint 'thumb'"),
        (["wrist", "--yes", "--port", "/dev/tty-that-is-not"], 1, "/dev/tty-that-is-not: no such port"),
        (["--yes", "--robot", "nobody"], 1, "no robot of that name"),
    ],
)
def test_an_invalid_adopt_option_is_refused_before_a_port_is_opened(
    words: list[str], capsys: pytest.CaptureFixture[str], more: list[str], code: int, message: str
) -> None:
    assert main([*words, *more]) == code
    shown = capsys.readouterr()
    assert message in shown.err + shown.out


@pytest.mark.slow
def test_killed_while_it_writes_the_same_command_ends_the_job(words: list[str], tmp_path: Path) -> None:
    """SIGKILL at other moments of the writing, seen by its own output; each on a servo as delivered."""
    command = [sys.executable, "-m", "twind.ctl.ctl_main", *words, "wrist", "--yes", "--port"]
    killed = 0
    for round in range(4):
        folder = tmp_path / str(round)
        folder.mkdir()
        with servo(folder) as port:
            one = subprocess.Popen([*command, port], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
            assert one.stderr is not None
            while not (line := one.stderr.readline()).startswith(b"becomes"):
                assert line, "it ended before it wrote"
            time.sleep(0.06 * round)
            one.kill()
            killed += one.wait(10) == -signal.SIGKILL
            one.stderr.close()
            again = subprocess.run([*command, port], capture_output=True, text=True, timeout=60)
            assert again.returncode == 0, again.stderr
            assert again.stdout.startswith("wrist has its servo"), again.stdout
    assert killed >= 2
