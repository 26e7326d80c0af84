"""The plug-in of LeRobot with lerobot's own commands, where an environment has both.

`TWIND_LEROBOT` names its folder of programs; it is made as integrations/lerobot/README.md says.
"""

import json
import os
import subprocess
from pathlib import Path

import pytest

from tests.support.processes import Daemon, patiently
from twind import Robot
from twind.client import Client

PROGRAMS = os.environ.get("TWIND_LEROBOT", "")
pytestmark = pytest.mark.skipif(not PROGRAMS, reason="TWIND_LEROBOT names no environment with lerobot")
ACT = """
import json, logging, sys
from lerobot_robot_twind import TwindRobot, TwindRobotConfig
logging.basicConfig(level=logging.WARNING)
robot = TwindRobot(TwindRobotConfig(socket=sys.argv[1]))
robot.connect()
for line in sys.stdin:
    action = dict.fromkeys(robot.action_features, 0.0) | json.loads(line)
    sent = robot.send_action(action)
    print(json.dumps({"sent": sent, "recorded": action}), flush=True)
robot.disconnect()
"""


def test_lerobot_teleoperate_brings_the_follower_to_the_leader(tmp_path: Path) -> None:
    leader = Daemon(tmp_path / "leader", "--mode", "sim", "--robot", "so101-leader")
    follower = Daemon(tmp_path / "follower", "--mode", "sim", "--robot", "so101")
    try:
        leader.reach(sim_connected=True)
        follower.reach(sim_connected=True)
        with Robot(leader.sockets) as hand:
            patiently(lambda: hand.move({"shoulder_pan": 0.4, "wrist_roll": -0.3}, time=2.0))
        arguments = ["--fps=30", "--teleop_time_s=3"]
        arguments += ["--robot.type=twind", f"--robot.socket={follower.sockets}"]
        arguments += ["--teleop.type=twind_leader", f"--teleop.socket={leader.sockets}"]
        done = subprocess.run(
            [str(Path(PROGRAMS) / "lerobot-teleoperate"), *arguments],
            capture_output=True,
            text=True,
            timeout=300.0,
            check=False,
            env={**os.environ, "HF_LEROBOT_HOME": str(tmp_path / "home")},
        )
        assert done.returncode == 0, done.stderr[-2000:]
        with Robot(follower.sockets, read_only=True) as robot:
            assert robot.joints["shoulder_pan"].position == pytest.approx(0.4, abs=0.03)
            assert robot.joints["wrist_roll"].position == pytest.approx(-0.3, abs=0.03)
    finally:
        leader.kill()
        follower.kill()


def test_the_recorded_action_is_what_the_gate_took(tmp_path: Path) -> None:
    """LeRobot records the dictionary that it gave to `send_action`."""
    follower = Daemon(tmp_path / "follower", "--mode", "sim", "--robot", "so101")
    try:
        follower.reach(sim_connected=True)
        command = [str(Path(PROGRAMS) / "python"), "-c", ACT, str(follower.sockets)]
        with (
            (tmp_path / "log").open("w+") as log,
            subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True
            ) as device,
            Client(follower.sockets) as operator,
        ):
            assert device.stdin is not None and device.stdout is not None

            def act(degrees: float) -> dict[str, dict[str, float]]:
                print(json.dumps({"shoulder_pan.pos": degrees}), file=device.stdin, flush=True)
                answer: dict[str, dict[str, float]] = json.loads(device.stdout.readline())
                return answer

            for asked, taken in ((10.0, 10.0), (170.0, 108.862)):  # the limit is 1.9 rad
                answer = act(asked)
                assert answer["recorded"] == answer["sent"]
                assert answer["sent"]["shoulder_pan.pos"] == pytest.approx(taken, abs=0.01)
            operator.call("EStop", level="cut")
            refused = act(50.0)
            assert refused["recorded"] == refused["sent"]
            assert refused["sent"]["shoulder_pan.pos"] != pytest.approx(50.0, abs=20.0)
            device.stdin.close()
            device.wait(30.0)
            log.seek(0)
            messages = log.read()
            assert "action clipped: shoulder_pan" in messages and "action refused: " in messages
    finally:
        follower.kill()
