"""The gap of a real daemon: a robot heavier than its identified model is reported, once."""

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.gap_rig import heavier
from tests.support.processes import Daemon, Virtual, arm, daemon, go
from twind.config.identified_file import dump_identified
from twind.config.identified_spec import GapReference, IdentifiedJoint
from twind.config.robot_file import load_robot
from twind.observe.plotting.plot_lines import gap_shares
from twind.observe.recording import open_recording
from twind.twin.binding import bind

pytestmark = pytest.mark.slow

JOINT = "elbow_flex"
REFERENCE = 0.12  # of the unmodified virtual arm, on elbow_flex; tests/identification/test_heavy_robot.py
SWINGS = 14  # of 2.4 s: ten seconds under torque, ten of the window, and three figures in a row


@contextmanager
def recorded(running: Daemon, folder: Path) -> Iterator[None]:
    """`twindctl record` into `folder`, meanwhile."""
    program = [sys.executable, "-m", "twind.ctl.ctl_main", "--socket", str(running.sockets), "record"]
    recorder = subprocess.Popen([*program, "--out", str(folder / "swings.mcap")], stdout=subprocess.DEVNULL)
    try:
        yield
    finally:
        recorder.send_signal(signal.SIGINT)
        recorder.wait(20.0)


@contextmanager
def driven(folder: Path, factor: float) -> Iterator[Daemon]:
    """A koch arm with links `factor` times as heavy as its daemon believes, armed and swinging."""
    robot = load_robot("koch")
    masses = heavier(bind(robot, None), factor)
    (folder / "masses.yaml").write_text(dump_identified(masses))
    known = replace(masses, bodies={}, joints={JOINT: IdentifiedJoint(gap=GapReference(0.02, REFERENCE))})
    (folder / "known.yaml").write_text(dump_identified(known))
    virtual = Virtual(folder, "koch", "--identified", str(folder / "masses.yaml"))
    try:
        with daemon(virtual, folder, more=["--identified", str(folder / "known.yaml")]) as running:
            running.reach(state="connected")
            with running.client() as client, recorded(running, folder):
                arm(client)
                for swing in range(SWINGS):
                    up = 0.4 if swing % 2 else -0.4
                    points = [
                        {"positions": [0.2 + at, 0.2 - at], "velocities": [0.0, 0.0], "time_from_start": time}
                        for at, time in ((up, 1.2), (-up, 2.4))
                    ]
                    go(client, {"joint_names": ["shoulder_lift", JOINT], "points": points}, 60.0)
            yield running
    finally:
        virtual.close()


def test_a_heavier_robot_is_reported_once(tmp_path: Path) -> None:
    with driven(tmp_path, 1.5) as running:
        gap = running.status()["gap"]
        log = running.log.read_text()
    joints = {each["joint"]: each["position"] for each in gap["joints"]}
    print(joints[JOINT], gap["total"])
    assert joints[JOINT]["unexplained"] > 1.5 * REFERENCE
    assert log.count("GAP_GROWN") == 1 and f"{JOINT}: " in log
    recording = open_recording(tmp_path / "swings.mcap")
    _, shares = gap_shares(recording)
    drawn = shares[:, recording.joints.index(JOINT)]
    assert np.nanmax(drawn) > 1.5 * REFERENCE
    assert any(said.what["code"] == "GAP_GROWN" for said in recording.events)
