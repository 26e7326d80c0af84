"""With each text of the daemon replaced by an `x`, bridge and uplink know a stop and the end of a motion.

`pytest --blank-messages` does the same with any other test.
"""

import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parents[2]
PATIENCE = 300.0  # s
TESTS = (
    "bridge/test_motion_session.py",
    "bridge/test_lease_keeper.py",
    "bridge/test_trajectory_dispatcher.py",
    "end_to_end/concurrent/test_ros_command_zenoh.py::test_a_trajectory_of_a_peer_moves_the_robot_and_its_end_is_published",
    "end_to_end/concurrent/test_ros_command_zenoh.py::test_a_stop_by_service_ends_a_motion",
    "end_to_end/concurrent/test_uplink_command_live.py::test_a_repeated_goal_runs_once_and_reports_its_outcome",
    "end_to_end/concurrent/test_uplink_command_live.py::test_a_client_without_the_lease_can_stop_the_motion",
    "end_to_end/concurrent/test_uplink_losses.py::test_a_killed_sender_releases_the_motion",
    "end_to_end/concurrent/test_uplink_losses.py::test_a_goal_that_waits_while_the_robot_is_stopped_does_not_begin_after_the_stop",
)


def test_bridge_and_uplink_handle_stops_and_motion_ends_without_message_texts() -> None:
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
