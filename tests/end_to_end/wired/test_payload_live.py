"""`twindctl payload` on a daemon and virtual servos: a mass in the hand of an arm without current sensors."""

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.support.contact_rig import identified
from tests.support.processes import Daemon, Virtual, arm, daemon, go
from twind.command_line.verb import DONE, REFUSED
from twind.config.identified_file import dump_identified
from twind.config.identified_spec import IdentifiedBody, ParameterEstimate
from twind.config.robot_file import load_robot
from twind.twin.binding import bind

ROBOT = "so101"
HAND = "hand"
STRETCHED = {"shoulder_lift": 0.5, "elbow_flex": -0.6, "wrist_flex": 0.0}
RAISED = {"shoulder_lift": 0.2, "elbow_flex": -0.9, "wrist_flex": -0.2}


@contextmanager
def holding(folder: Path, kg: float) -> Iterator[Daemon]:
    """A virtual arm with a mass in its hand, which its daemon does not know."""
    robot = load_robot(ROBOT)
    binding = bind(robot, None)
    friction = dict(zip(robot.names, binding.model.dof_frictionloss[binding.dof].tolist(), strict=True))
    stiffness = dict(zip(robot.names, binding.ratings.stiffness.tolist(), strict=True))
    known = identified(robot, friction, stiffness=stiffness).identified
    assert known is not None
    empty = float(binding.model.body_mass[binding.model.body(HAND).id])
    heavy = IdentifiedBody(mass_kg=ParameterEstimate(empty + kg, 0.0, empty, 0.0))
    (folder / "true.yaml").write_text(dump_identified(replace(known, joints={}, bodies={HAND: heavy})))
    (folder / "known.yaml").write_text(dump_identified(known))
    virtual = Virtual(folder, ROBOT, "--muscles", "mujoco", "--identified", str(folder / "true.yaml"))
    try:
        with daemon(virtual, folder, more=["--identified", str(folder / "known.yaml")]) as running:
            running.reach(state="connected")
            yield running
    finally:
        virtual.close()


def move(running: Daemon, pose: dict[str, float]) -> None:
    with running.client() as client:
        point = {"positions": list(pose.values()), "velocities": [0.0] * len(pose), "time_from_start": 2.5}
        go(client, {"joint_names": list(pose), "points": [point]})


def payload(running: Daemon, *words: str) -> "subprocess.CompletedProcess[str]":
    program = [sys.executable, "-m", "twind.ctl.ctl_main", "--socket", str(running.sockets), "--json"]
    return subprocess.run(
        [*program, "payload", HAND, *words], capture_output=True, text=True, timeout=60.0, check=False
    )


def estimated(running: Daemon) -> dict[str, Any]:
    """Return the answer of `payload`, of a second of readings."""
    done = payload(running, "--seconds", "1")
    assert done.returncode == DONE, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    print(found)
    return found


@pytest.mark.parametrize(
    "grams", [100, *(pytest.param(each, marks=pytest.mark.slow) for each in (0, 50, 200))]
)
def test_a_held_mass_is_found_within_its_interval_from_both_sides(tmp_path: Path, grams: int) -> None:
    with holding(tmp_path, grams / 1000.0) as running:
        before = payload(running)
        assert before.returncode == REFUSED and "no torque from outside is known" in before.stdout
        with running.client() as client:
            arm(client)
        found = []
        for pose in (STRETCHED, RAISED, STRETCHED):
            move(running, pose)
            found.append(estimated(running))
    for each in found:
        assert each["determined"]
        assert abs(each["mass_kg"] - grams / 1000.0) <= 2.0 * each["sd_kg"], found
    both = 0.5 * (found[0]["mass_kg"] + found[2]["mass_kg"])  # friction from below and from above
    assert both == pytest.approx(grams / 1000.0, abs=0.01), found
