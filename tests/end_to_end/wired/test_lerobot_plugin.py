"""The plug-in of LeRobot with lerobot's own commands, where an environment has both.

`TWIND_LEROBOT` names its folder of programs; it is made as integrations/lerobot/README.md says.
"""

import os
import subprocess
from pathlib import Path

import pytest

from tests.support.processes import Daemon, patiently
from twind import Robot

PROGRAMS = os.environ.get("TWIND_LEROBOT", "")
pytestmark = pytest.mark.skipif(not PROGRAMS, reason="TWIND_LEROBOT names no environment with lerobot")


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
            timeout=180.0,
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
