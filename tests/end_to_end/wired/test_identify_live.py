"""`twindctl identify --live` moves a joint of a virtual robot over pseudo-terminals and writes its model."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.live_robot import LiveRobot, live_robot
from tests.support.processes import Daemon, arm, robot, simulated
from twind.config.identified_file import identified_path, load_identified
from twind.config.robot_file import load_robot

ROBOT = "pan-tilt"


@pytest.fixture(scope="module")
def live() -> Iterator[LiveRobot]:
    with live_robot(ROBOT, "--muscles", "mujoco") as made:
        yield made


def identify(running: Daemon, *words: str) -> "subprocess.CompletedProcess[str]":
    command = [
        sys.executable,
        "-m",
        "twind.ctl.ctl_main",
        "--socket",
        str(running.sockets),
        "identify",
        "--live",
    ]
    return subprocess.run([*command, *words], capture_output=True, text=True, timeout=300.0)


@pytest.mark.slow
def test_one_joint_is_excited_and_its_model_written_shown_and_taken_at_the_next_start(
    live: LiveRobot,
) -> None:
    live.ready()
    with live.running.client() as client:
        arm(client)
    calibration = live.virtual.calibration
    done = identify(
        live.running,
        "tilt",
        "--robot",
        ROBOT,
        "--calibration",
        str(calibration),
        "--write",
        "--amplitude",
        "0.3",
    )
    assert done.returncode == 0, done.stderr
    model = load_identified(identified_path(calibration), load_robot(ROBOT))
    assert list(model.joints) == ["tilt"]
    assert model.source == "live"
    stiffness = model.joints["tilt"].stiffness_nm_per_rad
    assert stiffness is not None and stiffness.determined
    live.running.end()
    live.ready()
    with live.running.client() as client:
        assert client.call("GetRobot")["robot"]["identified"]["created"] == model.created


def test_a_joint_that_the_robot_lacks_is_refused_by_name(live: LiveRobot) -> None:
    live.ready()
    done = identify(live.running, "nod")
    assert done.returncode != 0
    assert "the robot has no joint 'nod'; it has pan, tilt" in done.stderr


def test_a_simulation_is_not_identified(tmp_path: Path) -> None:
    with simulated(tmp_path / "run", ROBOT) as running:
        done = identify(running)
    assert done.returncode != 0
    assert "the daemon is in mode sim, in which the robot does not move" in done.stderr


def test_a_daemon_does_not_start_with_a_model_of_another_robot() -> None:
    with robot(ROBOT) as (virtual, folder):
        path = identified_path(virtual.calibration)
        path.write_text(
            "format: twind-identified/1\nrobot: h24\ncreated: '2026-11-28T10:00:00Z'\ntool: t\nsource: s\n"
            "seconds: 1.0\nheld_out: 0.25\njoints: {}\nbodies: {}\n"
        )
        options = ["--mode", "live", "--robot", ROBOT, "--calibration", str(virtual.calibration)]
        port = next(iter(virtual.ports.values()))
        before = virtual.servos()
        refused = Daemon(folder / "run", *options, "--port", port)
        assert refused.process.wait(20.0) != 0
        assert f"{path}:2:8: robot: identified on robot 'h24', not on 'pan-tilt'" in refused.log.read_text()
        for servo, then in zip(virtual.servos(), before, strict=True):
            assert servo["position"] == pytest.approx(then["position"], abs=0.5)
        assert not any(servo["torque"] for servo in virtual.servos())
