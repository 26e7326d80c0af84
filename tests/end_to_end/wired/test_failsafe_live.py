"""`twind --failsafe` as the service manager runs it: real processes, real pseudo-terminals; the monitor."""

import os
import re
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from tests.proof.busmon.started import Relayed, relayed
from tests.support.free_standing_h24 import free_h24
from tests.support.processes import Daemon, Virtual, arm, daemon, favour, robot, until
from twind.client import Refused
from twind.config.robot_file import load_robot

RAISED = {"joint_names": ["r_shoulder_pitch"], "points": [{"positions": [-0.8], "time_from_start": 2.0}]}
FAR = 250  # counts from the rest pose
SHOWN = re.compile(rb"info (\w+): \w+ \xe2\x86\x92 \w+ ")  # an event of the robot's state
BY_HAND = "support it and switch its power off"


class Failsafe:
    """A running `twind --failsafe`."""

    def __init__(self, *options: str, relay: Relayed | None = None) -> None:
        command = [sys.executable, "-m", "twind.cli", "--failsafe", *options]
        self.process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE)
        favour(self.process)
        self.relay = relay
        self.said = b""

    def line(self) -> bytes:
        """Its next line; the monitor is told of states, as there is no socket to hear them from."""
        assert self.process.stderr is not None
        line: bytes = self.process.stderr.readline()
        self.said += line
        if self.relay is not None and (found := SHOWN.match(line)):
            self.relay.tell(told="state", state=found[1].decode())
        return line

    def end(self, seconds: float = 60.0) -> tuple[int, str]:
        """Exit code and all that it said."""
        while self.line():
            pass
        assert self.process.stderr is not None
        self.process.stderr.close()
        return self.process.wait(seconds), self.said.decode()


def options(virtual: Virtual, port: Path | str, *, mode: str = "live", name: str = "h24") -> list[str]:
    given = ["--mode", mode, "--robot", name, "--rate", "50"]  # a busy machine has time for that
    return [*given, "--calibration", str(virtual.calibration), "--port", str(port)]


def kill_on_the_way(running: Daemon, virtual: Virtual) -> None:
    """Armed, an arm on its way up: then SIGKILL, and every servo stopped by its own watchdog.

    A busy machine holds the motion now and then; it is asked for anew, from where it was held.
    """
    running.reach(state="connected")
    rest = places(virtual)
    with running.client() as client:
        arm(client)

        def raised() -> bool:
            with suppress(Refused):
                client.call("AcquireLease")
                for _ in client.stream("SubmitTrajectory", trajectory=RAISED):
                    if apart(places(virtual), rest) > FAR:
                        return True
            return False

        until(raised, 60.0, "an arm raised")
        running.end(signal.SIGKILL)
    until(lambda: all(servo["tripped"] for servo in virtual.servos()), 5.0, "watchdogs trip")
    until(lambda: all(abs(servo["velocity"]) < 1 for servo in virtual.servos()), 5.0, "rest")


def places(virtual: Virtual) -> list[float]:
    return [servo["position"] for servo in virtual.servos()]


def apart(one: list[float], other: list[float]) -> float:
    return max(abs(now - then) for now, then in zip(one, other, strict=True))


def torque(virtual: Virtual) -> set[bool]:
    return {bool(servo["torque"]) for servo in virtual.servos()}


def test_a_killed_daemon_leaves_a_robot_that_only_a_permitted_fail_safe_lowers(tmp_path: Path) -> None:
    with robot() as (virtual, folder):
        rest = places(virtual)
        observe = folder / "run" / "observe.sock"
        with relayed(
            folder,
            virtual.ports["main"],
            load_robot("h24").path,
            virtual.calibration,
            observe=observe,
            options=("--rate", "50"),
        ) as relay:
            favour(relay.process)
            running = Daemon(folder / "run", *options(virtual, relay.link))
            try:
                kill_on_the_way(running, virtual)
            finally:
                running.end(signal.SIGKILL)
            stood = places(virtual)
            assert apart(stood, rest) > FAR - 50

            damaged = tmp_path / "damaged.yaml"
            damaged.write_text(virtual.calibration.read_text().replace("zero_ticks: 2", "zero_ticks: 1", 1))
            code, said = Failsafe(
                *options(virtual, relay.link)[:-4], "--calibration", str(damaged), "--port", str(relay.link)
            ).end()
            assert (code, "sha256" in said, BY_HAND in said) == (2, True, True), said

            code, said = Failsafe(*options(virtual, relay.link, mode="mirror"), relay=relay).end()
            why = "mode mirror of the settings writes nothing"
            assert (code, why in said, BY_HAND in said) == (1, True, True), said
            assert apart(places(virtual), stood) <= 2
            assert torque(virtual) == {True}

            code, said = Failsafe(*options(virtual, relay.link), relay=relay).end()
            assert code == 0, said
            assert torque(virtual) == {False}
            assert apart(places(virtual), rest) < 60
            assert relay.end() == 0, relay.printed()
            counts: dict[str, Any] = relay.counts()
            assert counts["violations"] == 0
            assert counts["goals"] > 100


@pytest.mark.slow
def test_a_robot_on_its_own_feet_is_lowered_and_a_signal_on_the_way_does_not_end_it(tmp_path: Path) -> None:
    file = str(free_h24(tmp_path))
    with robot(file) as (virtual, folder):
        rest = places(virtual)
        with daemon(virtual, folder) as running:
            kill_on_the_way(running, virtual)
        safe = Failsafe(*options(virtual, virtual.folder / "ports" / "main", name=file))
        while b"settling" not in safe.line():
            assert safe.process.poll() is None, safe.said
        safe.process.send_signal(signal.SIGTERM)
        safe.process.send_signal(signal.SIGHUP)
        code, said = safe.end()
        assert code == 0, said
        assert "DAMP" not in said
        assert torque(virtual) == {False}
        assert apart(places(virtual), rest) < 60


def test_another_process_on_the_port_has_the_robot() -> None:
    with robot() as (virtual, folder), daemon(virtual, folder) as running:
        running.reach(state="connected")
        with running.client() as client:
            arm(client)
            code, said = Failsafe(*options(virtual, virtual.folder / "ports" / "main")).end()
            assert (code, str(running.process.pid) in said, BY_HAND in said) == (3, True, False), said
            assert running.status()["armed"]
            assert torque(virtual) == {True}
            client.call("Disarm")


@pytest.mark.slow
def test_a_port_that_is_not_there_is_waited_for(tmp_path: Path) -> None:
    with robot() as (virtual, _):
        began = time.monotonic()
        safe = Failsafe(*options(virtual, tmp_path / "ttyUSB7"))
        code, said = safe.end()
        assert 10.0 < time.monotonic() - began < 30.0
        assert (code, "ttyUSB7" in said, BY_HAND in said) == (1, True, True), said


@pytest.mark.parametrize(
    ("given", "code", "why"),
    [
        (["--config", "/nowhere/twind.yaml"], 2, "/nowhere/twind.yaml"),
        (["--mode", "live"], 2, "--port main=PORT"),
        (["--virtual"], 2, "leave out --virtual"),
        (["--mode", "sim"], 0, "no robot to lower"),
        ([], 0, "no robot to lower"),
    ],
)
def test_the_fail_safe_decides_by_the_files_before_it_opens_a_port(
    tmp_path: Path, given: list[str], code: int, why: str
) -> None:
    environment = {**os.environ, "XDG_CONFIG_HOME": str(tmp_path), "XDG_STATE_HOME": str(tmp_path)}
    command = [sys.executable, "-m", "twind.cli", "--failsafe", *given]
    ended = subprocess.run(
        command, env=environment, stderr=subprocess.PIPE, text=True, timeout=30, check=False
    )
    assert ended.returncode == code, ended.stderr
    assert why in ended.stderr
    assert (BY_HAND in ended.stderr) == (code == 2)
