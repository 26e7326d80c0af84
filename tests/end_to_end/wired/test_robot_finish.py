"""A robot from a file of other software, settled by hand until it arms and moves: real processes."""

import threading
import time
from pathlib import Path

import pytest

from tests.support.processes import Daemon, Virtual, arm, go
from twind.command_line.verb import Rejected
from twind.config.robot_file import read_robot
from twind.ctl.ctl_main import main
from twind.ctl.robot_file_edit import RobotFileEdit
from twind_calibration.drafting.finish_command import FinishTask
from twind_calibration.robot_description import RobotDescription

ROBOTIS = """
[ port info ]
main | 1000000 | shoulder
[ device info ]
dynamixel | main | 1 | XM430-W350 | 2.0 | shoulder | present_position
dynamixel | main | 2 | XM430-W350 | 2.0 | elbow    | present_position
"""
# The shoulder counts the other way round; its stops are narrower than anybody knows yet.
TRUTH = """
joints:
  shoulder: {sign: -1, zero_ticks: 2100, stops_rad: [-1.2, 1.0]}
  elbow: {zero_ticks: 1900, stops_rad: [-0.5, 1.5]}
"""
REST = {"shoulder": 0.3, "elbow": -0.2}
QUICK = 5.0  # rad/s


class Hands:
    """Hands that do what the questions ask for."""

    def __init__(self, virtual: Virtual) -> None:
        self.virtual = virtual
        self.asked: list[str] = []

    def move(self, **pose: float) -> None:
        self.virtual.order(fault="hand", pose=pose, speed=QUICK)
        time.sleep(0.8)

    def __call__(self, question: str) -> str:
        self.asked.append(question)
        joint = question.partition(":")[0]
        if "positive direction" in question:
            self.move(**{joint: 0.8})
        elif "hold the robot still" in question:
            self.move(**{joint: 0.0})
        elif "Lay the robot" in question:
            self.move(**REST)
        return "fixed" if "What carries" in question else ""


def started(virtual: Virtual, folder: Path, mode: str, robot: Path) -> Daemon:
    options = ("--mode", mode, "--robot", str(robot), "--port", str(virtual.folder / "ports" / "main"))
    running = Daemon(folder / "run", *options, environment={"STATE_DIRECTORY": str(folder / "state")})
    running.reach(state="connected")
    return running


def test_a_drafted_robot_is_settled_by_hand_and_moves(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "op.robot").write_text(ROBOTIS)
    (tmp_path / "truth.yaml").write_text(TRUTH)
    (tmp_path / "state").mkdir()
    made = tmp_path / "op"
    assert main(["robot", "new", "op", "--folder", str(made), "--from", str(tmp_path / "op.robot")]) == 0
    file = made / "op.yaml"
    comments = [line for line in file.read_text().splitlines() if line.startswith("#")]
    virtual = Virtual(
        tmp_path, str(file), "--muscles", "first-order", "--truth", str(tmp_path / "truth.yaml")
    )
    running = started(virtual, tmp_path, "mirror", file)
    hands = Hands(virtual)
    calibration = tmp_path / "state" / "calibration" / "op.yaml"

    def task() -> FinishTask:
        described = RobotDescription(read_robot(file), {}, None, calibration, tmp_path)
        return FinishTask(described, RobotFileEdit(file), hands)

    def restarted(mode: str) -> Daemon:
        assert running.end() == 0
        return started(virtual, tmp_path, mode, file)

    try:
        first = task()
        first.settle_answers(None, no_watchdog=False)
        later = task()  # it has read the changed file, and the daemon the one before
        with running.client() as client, pytest.raises(Rejected, match="another robot file"):
            later.settle_signs(client, later.open_joints("sign"))
        with running.client() as client:
            first.settle_signs(client, first.open_joints("sign"))
        assert [joint.sign for joint in read_robot(file).joints] == [-1, 1]
        assert first.todo == ("joints.shoulder.limits_rad", "joints.elbow.limits_rad", "poses.rest")

        running = restarted("mirror")
        _sweep(virtual, running)
        hands.move(shoulder=0.0, elbow=0.0)
        assert main(["--socket", str(running.sockets), "calibrate", "zero", "--yes"]) == 0

        running = restarted("mirror")
        last = task()
        last.settle_limits()
        with running.client() as client:
            last.settle_rest(client)
        robot = read_robot(file)
        assert robot.todo == ()
        limits = {joint.name: (joint.lower, joint.upper) for joint in robot.joints}
        assert limits["shoulder"] == pytest.approx((-1.17, 0.97), abs=0.02)
        assert limits["elbow"] == pytest.approx((-0.47, 1.47), abs=0.02)
        assert robot.poses["rest"] == pytest.approx(REST, abs=0.02)
        kept = file.read_text().splitlines()
        settled = ("todo", "no source states")  # these go with the last open item
        assert not [
            line for line in comments if line not in kept and not any(word in line for word in settled)
        ]

        virtual.order(fault="hand", off=True)
        running = restarted("live")
        with running.client() as client:
            arm(client)
            point = {"positions": [0.6], "velocities": [0.0], "time_from_start": 1.0}
            assert go(client, {"joint_names": ["shoulder"], "points": [point]})["phase"] == "succeeded"
            client.call("Disarm")
    finally:
        running.kill()
        virtual.close()


def _sweep(virtual: Virtual, running: Daemon) -> None:
    """Sweep, with hands that go from end to end until it has seen enough."""
    enough = threading.Event()

    def move() -> None:
        while not enough.is_set():
            for side in (-2.0, 2.0):
                virtual.order(fault="hand", pose=dict.fromkeys(REST, side), speed=2.0)
                enough.wait(2.0)

    mover = threading.Thread(target=move)
    mover.start()
    try:
        assert main(["--socket", str(running.sockets), "calibrate", "sweep", "--timeout", "12"]) == 0
    finally:
        enough.set()
        mover.join()
