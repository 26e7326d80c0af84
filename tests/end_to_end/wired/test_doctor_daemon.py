"""The doctor and real daemons: a healthy one gives no alarm, each thing that is wrong with one is found."""

import json
import os
import shutil
import signal
import socket
import stat
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.support.daemon_stand_ins import answering
from tests.support.doctor_rig import (
    found,
    look,
    mended,
    needs_root,
    options,
    run_with_own_mounts,
    unprivileged,
    way_to,
    wrong,
)
from tests.support.processes import Daemon, Virtual, daemon, favour, robot, until
from twind.client import Client
from twind.ctl.ctl_main import main
from twind.doctor import daemon as daemon_subject
from twind.doctor import host
from twind.doctor.check import DoctorFinding
from twind.doctor.check_context import CheckContext, examine
from twind.doctor.daemon import ENOUGH, MISSED
from twind.doctor.host_inspector import HostInspector
from twind.doctor.inspectors import PATIENCE
from twind.doctor.inspectors import DaemonInspector as Asked
from twind.version import __version__
from twind_drivers.clock import MonotonicClock

# What a machine may really lack: no false alarm of these is claimed here, but in test_doctor_machine.py.
OF_THE_MACHINE = {row.code for row in host.ROWS}


def port(virtual: Virtual) -> list[str]:
    return ["--port", str(virtual.folder / "ports/main"), "--calibration", str(virtual.calibration)]


def asked(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, dict[str, Any]]:
    """`twindctl --json WORDS`: its exit code and what it printed."""
    code = main(["--json", *words])
    said: dict[str, Any] = json.loads(capsys.readouterr().out)
    return code, said


# ------------------------------------------------------------------------------------------- a healthy robot


@pytest.fixture(scope="module")
def healthy() -> Iterator[tuple[Virtual, Path]]:
    with robot() as made:
        yield made


def test_a_healthy_robot_without_a_daemon_gives_no_alarm(
    healthy: tuple[Virtual, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    virtual, folder = healthy
    code, said = asked(capsys, "--socket", str(folder / "run"), "doctor", *port(virtual))
    counted = {each["code"] for each in said["found"] if each["severity"] != "note"}
    assert counted <= OF_THE_MACHINE, said["found"]
    assert code == (1 if counted else 0)
    assert {"files", "model", "ports", "latency", "baud rates", "holders"} <= set(said["looked"])
    assert said["not_looked"] == []


def test_a_latency_timer_without_a_file_is_measured(healthy: tuple[Virtual, Path]) -> None:
    virtual, folder = healthy
    words = port(virtual)
    assert found(*words, code="LATENCY_FLOOR", socket=folder) == []
    virtual.order(fault="latency", seconds=0.016, payload=62)
    try:
        (finding,) = found(*words, code="LATENCY_FLOOR", socket=folder)
    finally:
        virtual.order(fault="latency", seconds=0.0, payload=62)
    quickest = float(finding.measured.partition(" took ")[2].split()[0])
    assert 6.0 < quickest < 40.0, finding.measured


def test_a_healthy_robot_with_its_daemon_gives_no_alarm_and_is_left_alone(
    healthy: tuple[Virtual, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    virtual, folder = healthy
    with daemon(virtual, folder) as running:
        running.reach(state="connected")
        _, said = asked(capsys, "--socket", str(running.sockets), "doctor", *port(virtual))
        after = running.status()
        counted = {each["code"] for each in said["found"] if each["severity"] != "note"}
        loop = after["loop"]
        if loop["missed"] > MISSED * loop["ticks"] / 2:
            counted -= {"TICKS_MISSED"}  # this machine really is so busy
        assert counted <= OF_THE_MACHINE, said["found"]
        with closing(examine(options(socket=running.sockets), HostInspector(), MonotonicClock())) as examined:
            with Client(running.sockets, name="observe") as client:
                reported = client.call("GetParameters")["parameters"]
            assert examined.settings is not None
            assert str(examined.settings.calibration) == reported["calibration"] == str(virtual.calibration)
            assert str(examined.settings.state_dir) == reported["state_dir"]
        assert after["state"] == "connected" and not after["armed"] and after["lease"] is None
        assert {"daemon", "sockets", "versions", "files as read", "front", "latency"} <= set(said["looked"])
        # The same port, by somebody who does not know of this daemon: held, and not opened.
        held = look(*port(virtual), socket=folder / "elsewhere", only=["PORT_HELD", "LATENCY_FLOOR"])
        (finding,) = held.found
        assert f"pid {running.process.pid} " in finding.measured and "another twind has it" in finding.advice
        assert any("is held by" in why for _, why in held.unseen)
        assert running.status()["state"] == "connected"


@pytest.mark.slow
def test_a_daemon_without_readings_because_of_a_latency_timer_is_explained(
    healthy: tuple[Virtual, Path],
) -> None:
    """Replies that wait in the adapter past the deadline are lost.

    Where the daemon has measured how late they come, the doctor reports that; else it reports what it could
    not check, with a remedy.
    """
    virtual, folder = healthy
    with daemon(virtual, folder, mode="mirror") as running:
        running.reach(state="connected")
        assert found(code="LATENCY_FLOOR", socket=running.sockets) == []
        virtual.order(fault="latency", seconds=0.016, payload=510)
        try:
            bus = until(lambda: deaf(running), 20.0, "more readings lost than whole")
            outcome = look(socket=running.sockets, only=["LATENCY_FLOOR"])
        finally:
            virtual.order(fault="latency", seconds=0.0, payload=62)
    if outcome.found:
        assert [each.measured.startswith("replies come ") for each in outcome.found] == [True], bus
        return
    assert "latency" not in outcome.looked, bus
    ((what, why),) = outcome.unseen
    assert what == "latency" and why.endswith("stop it and ask again, then the port itself is measured")


def deaf(running: Daemon) -> dict[str, Any] | None:
    bus: dict[str, Any] = running.status()["buses"][0]
    return bus if bus["errors"] > 0.6 * bus["exchanges"] else None


# --------------------------------------------------------------------------------- a daemon in trouble

OTHER = (
    "import sys, twind.version as v; v.__version__ = '0.0.1'; from twind.cli import main; sys.exit(main())"
)


@pytest.fixture(scope="module")
def troubled(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    """A daemon of another version, in sim, of a robot file that can be edited."""
    folder = tmp_path_factory.mktemp("troubled")
    for suffix in ("yaml", "xml"):
        shutil.copy(Path(__file__).parents[3] / f"twind/robots/h24.{suffix}", folder)
    running = Daemon.__new__(Daemon)
    running.sockets = folder / "run"
    running.log = folder / "log"
    running.sockets.mkdir()
    words = ["--socket", str(running.sockets), "--mode", "sim", "--rate", "250"]
    words += ["--robot", str(folder / "h24.yaml")]
    with running.log.open("ab") as log:
        running.process = subprocess.Popen(
            [sys.executable, "-c", OTHER, *words], stderr=log, stdin=subprocess.DEVNULL
        )
    favour(running.process)
    running.reach()
    yield running
    running.end()


def test_a_daemon_of_another_version_is_found(troubled: Daemon) -> None:
    (finding,) = found(code="VERSION_DIFFERS", socket=troubled.sockets)
    assert finding.command.endswith("sudo systemctl restart twind.service")
    assert (finding.measured, finding.expected) == ("version 0.0.1", f"{__version__}, as twindctl")


def test_a_socket_with_permissions_for_all_users_is_found_and_restricted(troubled: Daemon) -> None:
    control = troubled.sockets / "control.sock"
    assert found(code="SOCKET_OPEN", socket=troubled.sockets) == []
    control.chmod(0o666)
    (finding,) = found(code="SOCKET_OPEN", socket=troubled.sockets)
    assert (finding.thing, finding.measured, finding.expected) == (str(control), "mode 0666", "0660")
    (tried,) = mended(code="SOCKET_OPEN", socket=troubled.sockets)
    assert not tried.there and stat.S_IMODE(control.stat().st_mode) == 0o660


@pytest.mark.parametrize(("answer", "mode"), [("n\n", 0o666), ("\n", 0o666), ("\x04", 0o666), ("y\n", 0o660)])
def test_fix_prints_its_change_and_waits_for_confirmation(
    troubled: Daemon,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    answer: str,
    mode: int,
) -> None:
    control = troubled.sockets / "control.sock"
    control.chmod(0o666)
    master, slave = os.openpty()
    os.write(master, answer.encode())
    with os.fdopen(slave) as terminal:
        monkeypatch.setattr("sys.stdin", terminal)
        code = main(["--socket", str(troubled.sockets), "doctor", "--only", "SOCKET_OPEN", "--fix"])
    os.close(master)
    said = capsys.readouterr().out
    assert f"--fix would do:\n    {control}: mode 0660" in said
    assert stat.S_IMODE(control.stat().st_mode) == mode and code == (mode == 0o666)
    assert ("mended: mode 0660" in said) == (mode == 0o660)
    control.chmod(0o660)


def test_a_socket_folder_writable_by_all_users_is_found_and_restricted(troubled: Daemon) -> None:
    troubled.sockets.chmod(0o777)
    (finding,) = found(code="SOCKET_OPEN", socket=troubled.sockets)
    assert finding.thing == str(troubled.sockets)
    (tried,) = mended(code="SOCKET_OPEN", socket=troubled.sockets)
    assert not tried.there and stat.S_IMODE(troubled.sockets.stat().st_mode) == 0o755


def test_a_robot_file_that_was_edited_under_the_daemon_is_found(troubled: Daemon) -> None:
    assert edited(troubled) == []
    file = troubled.sockets.parent / "h24.yaml"
    file.write_text(file.read_text() + "# a thought\n")
    (finding,) = edited(troubled)
    assert finding.thing == str(file) and finding.command == "twindctl reload"
    assert main(["--socket", str(troubled.sockets), *finding.command.split()[1:]]) == 0
    assert edited(troubled) == []


def edited(running: Daemon) -> list[DoctorFinding]:
    """Findings about files of a daemon that has another version too."""
    differing = found(code="VERSION_DIFFERS", socket=running.sockets)
    return [each for each in differing if each.thing != "the daemon"]


def test_missed_ticks_and_a_new_front_are_found(troubled: Daemon) -> None:
    until(lambda: troubled.status()["loop"]["ticks"] > 2 * ENOUGH, 30.0, "1000 ticks")
    assert found(code="UNIT_RESTARTED", socket=troubled.sockets) == []
    before = troubled.status()["loop"]
    troubled.process.send_signal(signal.SIGSTOP)
    time.sleep(0.04 * (before["ticks"] + before["missed"]) / 250 + 0.1)  # a 25th of its life
    troubled.process.send_signal(signal.SIGCONT)
    until(lambda: troubled.status()["loop"]["missed"] > before["missed"], 5.0, "missed ticks")
    (finding,) = found(code="TICKS_MISSED", socket=troubled.sockets)
    assert "ticks missed" in finding.measured and finding.expected == "at most 1%"
    first = troubled.front()
    os.kill(first, signal.SIGKILL)
    until(lambda: fresh(troubled, first), 20.0, "a new front")
    (finding,) = found(code="UNIT_RESTARTED", socket=troubled.sockets)
    assert finding.thing == f"front, pid {troubled.front()}" and "it was restarted" in finding.measured


def fresh(running: Daemon, first: int) -> bool:
    try:
        return running.front() != first and bool(running.status())
    except Exception:
        return False


# --------------------------------------------------------------------------------- no daemon to speak of


@contextmanager
def listening(folder: Path) -> Iterator[Path]:
    """Somebody who takes connections and says nothing."""
    path = folder / "control.sock"
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as listener:
        listener.bind(str(path))
        listener.listen(8)
        yield path


def test_no_daemon_is_a_note_whether_its_socket_is_left_or_not(tmp_path: Path) -> None:
    (finding,) = found(code="NO_DAEMON", socket=tmp_path)
    assert finding.measured == "there is no such socket"
    installed = Path("/run/systemd/system").is_dir() and Path("/etc/systemd/system/twind.service").exists()
    assert finding.command == ("sudo systemctl start twind" if installed else "twind")
    with listening(tmp_path):
        pass
    outcome = look(socket=tmp_path, only=["NO_DAEMON"])
    assert [each.measured for each in outcome.found] == ["no program listens on it"] and wrong(
        outcome
    ) == set()


def test_a_daemon_without_replies_is_found_after_one_timeout(tmp_path: Path) -> None:
    with listening(tmp_path):
        begun = time.monotonic()
        outcome = look(
            socket=tmp_path, only=["DAEMON_SILENT", "VERSION_DIFFERS", "TICKS_MISSED", "NO_REALTIME"]
        )
        lasted = time.monotonic() - begun
    assert [each.code for each in outcome.found] == ["DAEMON_SILENT"]
    assert PATIENCE - 0.1 < lasted < 2 * PATIENCE, lasted


@needs_root
def test_a_user_without_socket_permission_receives_the_name_of_the_group(tmp_path: Path) -> None:
    for folder in way_to(tmp_path):
        folder.chmod(0o755)
    with listening(tmp_path) as path:
        path.chmod(0o660)
        os.chown(path, 0, 20)
        look(socket=tmp_path / "none")  # every module is loaded before the user is another one
        with unprivileged():
            outcome = look(socket=tmp_path, only=["DAEMON_DENIED"])
        (finding,) = outcome.found
        assert finding.code == "DAEMON_DENIED" and "user nobody is not in group" in finding.measured
        assert finding.command.startswith("sudo usermod -aG ") and "log in again" in finding.advice
        os.chown(path, 0, 0)
        with unprivileged():
            outcome = look(socket=tmp_path, only=["DAEMON_DENIED"])
        (finding,) = outcome.found
        assert "started by hand" in finding.measured and finding.command in (
            "twind",
            "sudo systemctl start twind",
        )
        assert "usermod" not in f"{finding.command} {finding.advice}", "nobody joins the group root"
        tmp_path.chmod(0o700)
        with unprivileged():
            outcome = look(socket=tmp_path, only=["DAEMON_DENIED"])
        assert "may not enter the folder" in outcome.found[0].measured
    for mode in (0o700, 0o755):  # the socket is left, and nobody has it
        tmp_path.chmod(mode)
        with unprivileged():
            outcome = look(socket=tmp_path, only=["DAEMON_DENIED", "NO_DAEMON"])
        assert [each.code for each in outcome.found] == ["NO_DAEMON"], mode


def test_the_daemons_own_faults_are_named_with_what_they_keep_from_arming(tmp_path: Path) -> None:
    def fault(code: str, joint: str | None, message: str) -> dict[str, Any]:
        return {"code": code, "joint": joint, "message": message}

    faults = [fault("DEVICE_MISSING", f"j{number}", "no answer") for number in range(24)]
    faults += [fault("FOREIGN_TRAFFIC", None, "packets on bus main in a second that were not requested")]
    with answering(tmp_path) as make:
        make("control", lambda _: {"parameters": {"status": {"faults": faults}, "joints": []}})
        seen = CheckContext(HostInspector(), "twind.service", daemon=Asked(Client(tmp_path)))
        missing, foreign = daemon_subject.check_faults(seen)
        seen.close()
    assert missing.code == "DAEMON_FAULT" and missing.measured == "no answer"
    assert missing.thing.startswith("DEVICE_MISSING, 24 joints: j0, j1, ")
    assert (foreign.thing, foreign.measured) == ("FOREIGN_TRAFFIC", faults[-1]["message"])
    assert "two servos with one id" in foreign.advice and "`sudo systemctl stop twind " in foreign.advice


# --------------------------------------------------------------------------------- the group of a socket

GROUPED = """
cp /etc/group "$1/group"; echo "twind-operator:x:7701:" >> "$1/group"
mount --bind "$1/group" /etc/group || exit 77
"$2" -m twind.cli --socket "$1/run" --mode sim 2> "$1/log" &
for i in $(seq 200); do [ -S "$1/run/observe.sock" ] && break; sleep 0.05; done
stat -c %G "$1/run/control.sock"
chgrp 0 "$1/run/control.sock"
"$2" -m twind.ctl.ctl_main --socket "$1/run" --json doctor --only SOCKET_GROUP --fix --yes
stat -c %G "$1/run/control.sock"
kill $!; wait $!
"""


@needs_root
def test_a_socket_of_the_wrong_group_is_found_and_given_to_the_right_one(tmp_path: Path) -> None:
    """On a machine that has the service's group; only these processes see it."""
    given, said, after = run_with_own_mounts(GROUPED, tmp_path).splitlines()
    assert given == after == "twind-operator"
    (finding,) = json.loads(said)["found"]
    assert finding["code"] == "SOCKET_GROUP"
    assert (finding["measured"], finding["expected"]) == ("group root", "twind-operator")
    (tried,) = json.loads(said)["mended"]
    assert not tried["still_there"] and tried["error"] is None
