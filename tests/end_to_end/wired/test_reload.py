"""The files read again, by real daemons: asked on the socket, by SIGHUP; and when a terminal closes."""

import contextlib
import fcntl
import json
import os
import pty
import re
import signal
import socket
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.processes import Daemon, Virtual, arm, robot, until
from tests.support.reload_rig import files
from twind.client import CallError, Refused

LINE = "head_yaw:         {id: 1, limits_rad: [-1.5, 1.5]"
NARROW = {LINE: "head_yaw:         {id: 1, limits_rad: [-0.3, 0.3]"}
PATH = {
    "joint_names": ["head_yaw"],
    "points": [{"positions": [0.4], "velocities": [0.0], "time_from_start": 3.0}],
}


@contextlib.contextmanager
def simulated(folder: Path, **environment: str) -> Iterator[Daemon]:
    sources = files(folder)
    running = Daemon(folder / "run", "--config", str(sources.config), environment=environment)
    try:
        running.reach(mode="sim")
        yield running
    finally:
        running.end()


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    with simulated(tmp_path_factory.mktemp("reload")) as running:
        until(lambda: "LOOKAHEAD" in running.log.read_text(), 10.0, "the front's model")
        yield running


@pytest.fixture
def sim(shared: Daemon) -> Daemon:
    """A simulated daemon with the first files and an empty log.

    Limits that an earlier test made narrower stay in force, since wider ones need a restart.
    """
    files(shared.sockets.parent)
    with shared.client() as client:
        client.call("Reload")
    os.truncate(shared.log, 0)  # the daemon appends
    return shared


def ctl(running: Daemon, *words: str) -> tuple[int, str]:
    command = [sys.executable, "-m", "twind.ctl.ctl_main", "--socket", str(running.sockets), *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30.0, check=False)
    return done.returncode, done.stdout + done.stderr


def limits(running: Daemon) -> tuple[float, float]:
    """Limits of head_yaw in force."""
    with running.client() as client:
        joints = client.call("GetRobot")["robot"]["joints"]
    joint = next(joint for joint in joints if joint["name"] == "head_yaw")
    return joint["lower"], joint["upper"]


def refused(running: Daemon) -> list[str]:
    """Verdict on a path to 0.4 rad."""
    with running.client() as client:
        verdict = client.call("Check", trajectory=PATH)["verdict"]
    return [finding["code"] for finding in verdict["refusals"]]


def test_a_reload_is_in_force_on_both_sides_and_for_the_next_front(sim: Daemon) -> None:
    folder = sim.sockets.parent
    assert (limits(sim), refused(sim)) == ((-1.5, 1.5), [])
    files(folder, "log_level: debug\nrate_hz: 50\n", NARROW)
    code, said = ctl(sim, "--json", "reload")
    assert (code, json.loads(said)) == (
        0,
        {"applied": ["joints.head_yaw.limits_rad", "log_level"], "needs_restart": ["rate_hz"]},
    )
    assert limits(sim) == (-0.3, 0.3)
    assert "POS_LIMIT" in refused(sim)
    code, said = ctl(sim, "reload")
    assert code == 0 and said.startswith("needs a restart: rate_hz\nrestart the daemon, disarmed: `")
    front = sim.front()
    os.kill(front, signal.SIGKILL)
    until(lambda: _other_front(sim, front), 10.0, "a new front")
    sim.reach(mode="sim")
    until(lambda: "LOOKAHEAD" in sim.log.read_text(), 10.0, "the new front's model")
    assert limits(sim) == (-0.3, 0.3)
    assert "POS_LIMIT" in refused(sim)
    with sim.client() as client:
        shown = client.call("GetParameters")["parameters"]
    assert (shown["log_level"], shown["rate_hz"]) == ("debug", None)


def _other_front(running: Daemon, old: int) -> bool:
    with contextlib.suppress(AssertionError, OSError):
        return running.front() != old
    return False


def test_a_refused_file_changes_nothing_and_reports_its_position(sim: Daemon) -> None:
    folder = sim.sockets.parent
    with sim.client() as client:
        before = client.call("GetRobot"), client.call("GetParameters")
    files(folder, "log_levl: debug\n", NARROW)
    code, said = ctl(sim, "reload")
    assert code == 1
    assert f"{folder}/twind.yaml:3:1: log_levl: unknown key; nearest: log_level" in said
    with sim.client() as client:
        assert (client.call("GetRobot"), client.call("GetParameters")) == before
    assert "RELOAD_REFUSED" in sim.log.read_text()
    (folder / "twind.yaml").write_bytes(b"\x00\xff" * 1000)
    assert ctl(sim, "reload")[0] == 1
    sim.reach(mode="sim")


def test_reloads_wait_for_each_other_and_all_are_answered(sim: Daemon) -> None:
    folder = sim.sockets.parent
    files(folder, "log_level: error\n", {LINE: NARROW[LINE].replace("0.3", "0.2")})
    command = [sys.executable, "-m", "twind.ctl.ctl_main", "--socket", str(sim.sockets), "--json", "reload"]
    asked = [subprocess.Popen(command, stdout=subprocess.PIPE) for _ in range(3)]
    told = [json.loads(one.communicate(timeout=30.0)[0]) for one in asked]
    assert [one.returncode for one in asked] == [0, 0, 0]
    applied = sorted(key for one in told for key in one["applied"])
    assert applied == ["joints.head_yaw.limits_rad", "log_level"], "once, by one of them"


def test_a_client_may_set_what_is_hot_and_only_tighter(sim: Daemon) -> None:
    with sim.client() as client:
        answer = client.call("SetParameters", parameters={"latency_warn_ms": 20, "log_level": "warning"})
        shown = client.call("GetParameters")["parameters"]
        assert answer == {"parameters": shown, "needs_restart": []}
        assert (shown["latency_warn_ms"], shown["log_level"]) == (20.0, "warning")
        assert shown["origins"]["latency_warn_ms"] == "SetParameters"
        for wrong in (
            {"latency_warn_ms": 30},
            {"latency_block_ms": 10},
            {"rate_hz": 50},
            {"log_level": "loud"},
            {},
        ):
            with pytest.raises(CallError):
                client.call(
                    "SetParameters", parameters={**({"log_level": "debug"} if wrong else {}), **wrong}
                )
        assert client.call("GetParameters")["parameters"] == shown, "not one of them in part"
        code, said = ctl(sim, "parameters", "log_level=error")
        assert code == 0
        assert re.search(r"^log_level +error +SetParameters$", said, re.MULTILINE)
        assert re.search(r"^rate_hz +- +default$", ctl(sim, "parameters")[1], re.MULTILINE)
        assert ctl(sim, "parameters", "latency_warn_ms=49")[0] == 1
        assert ctl(sim, "parameters", "log_level")[0] == 2
        assert client.call("Reload")["applied"] == ["log_level", "thresholds.latency_warn_ms"]
        assert client.call("GetParameters")["parameters"]["origins"].keys() == {
            "mode",
            "robot",
            "sockets",
        }


def test_a_sighup_without_a_terminal_reloads_and_notifies_the_service_manager(tmp_path: Path) -> None:
    manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    manager.bind(str(tmp_path / "notify"))
    manager.settimeout(20.0)

    def hear(*wanted: str) -> str:
        while True:
            said = manager.recv(4096).decode()
            if said.startswith(wanted):
                return said

    with manager, simulated(tmp_path, NOTIFY_SOCKET=str(tmp_path / "notify")) as running:
        hear("READY=1")
        for text, expected in (("log_level: debug\n", "RELOADED"), ("log_level: loud\n", "RELOAD_REFUSED")):
            files(tmp_path, text)
            asked = time.monotonic()
            os.kill(running.process.pid, signal.SIGHUP)
            said = hear("RELOADING=1")
            stamp = int(said.removeprefix("RELOADING=1\nMONOTONIC_USEC="))
            assert asked * 1e6 <= stamp <= time.monotonic() * 1e6
            assert hear("READY=1", "RELOADING=1").startswith("READY=1")
            until(lambda: expected in running.log.read_text(), 5.0, expected)  # noqa: B023
        while f"; the last reload was refused: {tmp_path}/twind.yaml:3:12: log_level" not in hear("STATUS="):
            pass
        assert running.process.poll() is None


HUNG_UP = """
import os, signal, sys
from twind import cli

def describe(sources, read=cli.describe):
    os.kill(os.getpid(), signal.SIGHUP)  # the files are not read yet
    return read(sources)

cli.describe = describe
sys.exit(cli.main(sys.argv[1:]))
"""


def test_a_hang_up_while_a_daemon_starts_ends_nothing_and_is_a_reload(tmp_path: Path) -> None:
    sources = files(tmp_path)
    log = tmp_path / "log"
    command = [sys.executable, "-c", HUNG_UP, "--socket", str(tmp_path / "run"), "--config"]
    with log.open("wb") as said:
        process = subprocess.Popen([*command, str(sources.config)], stderr=said, start_new_session=True)
    try:
        until(lambda: process.poll() is not None or "RELOADED" in log.read_text(), 20.0, "the reload")
        assert process.poll() is None
        process.terminate()
        assert process.wait(20.0) == 0
    finally:
        if process.poll() is None:
            process.kill()
        process.wait(10.0)


class Terminal:
    """A daemon started in a terminal of its own."""

    def __init__(self, folder: Path, *before: str) -> None:
        sources = files(folder)
        self.master, slave = pty.openpty()

        def own() -> None:
            signal.signal(signal.SIGHUP, signal.SIG_DFL)  # these tests may have been started with nohup
            os.setsid()
            fcntl.ioctl(slave, termios.TIOCSCTTY, 0)

        self.log = folder / "log"
        command = [*before, sys.executable, "-m", "twind.cli", "--socket", str(folder / "run"), "--config"]
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(
                [*command, str(sources.config)],
                cwd=folder,  # where nohup leaves its file
                stdin=slave,
                stdout=slave,
                stderr=log,
                preexec_fn=own,
            )
        os.close(slave)
        until(lambda: "LOOKAHEAD" in self.log.read_text(), 20.0, "the daemon's front")

    def say(self, event: str) -> None:
        until(lambda: event in self.log.read_text(), 10.0, f"{event}: {self.log.read_text()}")

    def end(self) -> None:
        if self.process.poll() is None:
            self.process.terminate()
        self.process.wait(20.0)


def test_a_terminal_that_closes_ends_its_daemon_and_a_hang_up_before_reloads(tmp_path: Path) -> None:
    here = Terminal(tmp_path)
    try:
        os.kill(here.process.pid, signal.SIGHUP)
        here.say("RELOADED")
        os.close(here.master)
        assert here.process.wait(20.0) == 0
        assert "STOPPING" in here.log.read_text()
    finally:
        here.end()


def test_under_nohup_a_terminal_that_closes_ends_nothing(tmp_path: Path) -> None:
    here = Terminal(tmp_path, "nohup")
    try:
        os.close(here.master)
        here.say("RELOADED")
        assert here.process.poll() is None
    finally:
        here.end()


# ------------------------------------------------------------------------------- a robot with torque


@contextlib.contextmanager
def live(virtual: Virtual, folder: Path) -> Iterator[Daemon]:
    sources = files(folder)
    port = f"main={folder / 'ports' / 'main'}"
    options = ["--config", str(sources.config), "--mode", "live", "--calibration", str(virtual.calibration)]
    running = Daemon(folder / "run", *options, "--port", port)
    try:
        yield running
    finally:
        if running.process.poll() is None:
            running.process.kill()
        running.process.wait(10)


def test_limits_wait_for_torque_off_and_a_file_that_was_read_again_may_be_armed_by() -> None:
    with robot("h24") as (virtual, folder), live(virtual, folder) as running:
        running.reach(state="connected")
        until(lambda: "LOOKAHEAD" in running.log.read_text(), 10.0, "the front's model")
        with running.client() as client:
            arm(client)
            files(folder, "", NARROW)
            with pytest.raises(Refused) as answer:
                client.call("Reload")
            assert [finding["code"] for finding in answer.value.findings] == ["BUSY"]
            assert limits(running) == (-1.5, 1.5)
            assert running.status()["armed"]
            client.call("Disarm")
            calibration = virtual.calibration.read_text()
            virtual.calibration.write_text(calibration + "\n")
            with pytest.raises(Refused) as answer:
                arm(client)
            found = answer.value.findings
            assert [finding["code"] for finding in found] == ["CALIB_MISMATCH"] * 2
            assert any(str(virtual.calibration) in finding["message"] for finding in found)
            virtual.calibration.write_text(calibration)
            applied = until(lambda: _reload(client), 10.0, "torque read back off")
            assert applied == ["joints.head_yaw.limits_rad"]
            arm(client)
            client.call("AcquireLease")
            with pytest.raises(Refused) as answer:
                client.call("SubmitTrajectory", trajectory=PATH)
            assert "POS_LIMIT" in {finding["code"] for finding in answer.value.findings}


def _reload(client: Any) -> list[str] | None:
    try:
        return client.call("Reload")["applied"]
    except Refused:
        return None
