"""With each text of the daemon replaced by an `x`, the bridge knows a stop and the end of a motion.

`pytest --blank-messages` does the same with any other test. The fixture `blank_messages` does it for whole
processes: test_ros_command_zenoh.py and the tests of the uplink run with it.
"""

import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parents[2]
PATIENCE = 120.0  # s
TESTS = (
    "bridge/test_leased_motions.py",
    "bridge/test_remote_goals.py",
    "bridge/test_ros_commands.py",
)


def test_the_bridge_handles_stops_and_motion_ends_without_message_texts() -> None:
    tests = [str(HERE / each) for each in TESTS]
    options = ["-p", "no:cacheprovider", "-p", "no:xdist", "--blank-messages", "-m", "not slow", "--tb=short"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options, *tests],
        cwd=HERE.parent,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-6000:]


def test_the_texts_are_blank_in_every_process_that_a_test_starts() -> None:
    made = "Finding(ReasonCode.BUSY, message='why')"
    code = f"from twind.robot.finding import Finding, ReasonCode; print({made}.message)"
    environment = {"PYTHONPATH": str(HERE / "support" / "blanked")}
    assert subprocess.check_output([sys.executable, "-c", code], env=environment, text=True) == "x\n"
