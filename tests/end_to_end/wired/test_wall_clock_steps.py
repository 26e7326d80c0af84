"""Steps of the wall clock by hours, while armed: motion, stream, lease and recording do not notice."""

import itertools
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mcap.reader import make_reader

from tests.support.processes import BUSY, LATCHED, Daemon, arm, go, robot, until
from tests.support.wall_clock_shim import LIBRARY, WallClockShim
from twind import Robot
from twind.client import Refused
from twind.observe.recording import open_recording
from twind.observe.recording.recording_topics import MEASURED, NOTES

HOUR = 3600
STEPS = (3 * HOUR, -6 * HOUR, 0, -1, 400 * 24 * HOUR, -3 * HOUR, HOUR)
PAUSE = 0.25  # s between two
LONGEST = 120.0  # s that the recording lasts at most: shorter than any step but one
MOVED = {
    "joint_names": ["pan"],
    "points": [
        {"positions": [0.3], "time_from_start": 1.5},
        {"positions": [0.0], "time_from_start": 3.0},
    ],
}


@contextmanager
def stepped(clock: WallClockShim) -> Iterator[None]:
    """The clock is stepped from side to side."""
    over = threading.Event()

    def run() -> None:
        for seconds in itertools.cycle(STEPS):
            clock.step(seconds)
            if over.wait(PAUSE):
                return

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join(10)


@contextmanager
def recorded(running: Daemon, clock: WallClockShim, out: Path) -> Iterator[int]:
    """A recording; the pid of its program."""
    words = ["--socket", str(running.sockets), "record", "--free", "0", "--out", str(out)]
    recorder = subprocess.Popen(
        [sys.executable, "-m", "twind.ctl.ctl_main", *words],
        env=os.environ | clock.environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        until(out.exists, 30.0, "it records nothing")
        yield recorder.pid
        recorder.terminate()
        assert recorder.wait(20) == 0
    finally:
        recorder.kill()
        recorder.wait(10)


def streamed(sockets: Path) -> None:
    """Goals of a stream are accepted; a busy machine may refuse some."""
    with Robot(str(sockets), take=True) as held:
        with held.stream(["tilt"], rate=50, strict=False) as stream:
            for at in stream:
                stream.send({"tilt": 0.05 * min(at, 1.0)})
                if at > 2.0:
                    break
        report = stream.report
        assert report.accepted > 10, report
        if isinstance(report.refusal, Refused):
            assert {each["code"] for each in report.refusal.findings} <= BUSY | LATCHED, report


def test_steps_of_the_wall_clock_by_hours_disturb_neither_robot_nor_recording(tmp_path: Path) -> None:
    clock = WallClockShim(tmp_path)
    out = tmp_path / "one.mcap"
    with robot("pan-tilt") as (virtual, folder):
        options = ["--mode", "live", "--robot", virtual.robot, "--calibration", str(virtual.calibration)]
        options += ["--port", f"main={virtual.folder / 'ports' / 'main'}"]
        running = Daemon(folder / "run", *options, environment=clock.environment)
        try:
            running.reach(60.0, state="connected", hw_connected=True)
            with recorded(running, clock, out) as recorder:
                for pid in (running.process.pid, running.front(), recorder):
                    assert LIBRARY in Path(f"/proc/{pid}/maps").read_text(), "its clock is not stepped"
                with stepped(clock):
                    with running.client() as client:
                        arm(client)
                        go(client, MOVED)
                    streamed(running.sockets)
                    time.sleep(PAUSE)
                assert running.status()["state"] == "armed", running.log.read_text()
            assert running.end() == 0
        finally:
            running.kill()
        said = running.log.read_text()
        assert not any(code in said for code in ("LEASE_LOST", "TIME_GAP", "CMD_EXPIRED")), said
        assert not any(servo["torque"] for servo in virtual.servos())
    _judge(out)


def _judge(out: Path) -> None:
    """One recording, whole, in the order of its states; the steps are noted, and are in no time of it."""
    found = open_recording(out)
    assert found.damage == ""
    assert (found.time[1:] > found.time[:-1]).all()
    with out.open("rb") as file:
        reader = make_reader(file)
        states = [each.log_time for _, _, each in reader.iter_messages([MEASURED], log_time_order=False)]
        notes = b"".join(each.data for _, _, each in reader.iter_messages([NOTES]))
    assert states == sorted(states) and len(states) > 100
    assert states[-1] - states[0] < LONGEST * 1e9
    assert b'"clock_step"' in notes
