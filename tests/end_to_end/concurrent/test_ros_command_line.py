"""The `ros2` command and the bridge in their default graphs: a command arrives, or its user sees it wait.

Both run in a network of their own: `python test_ros_command_line.py SOCKETS FOLDER COUNT BACKEND...` there.
"""

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from tests.support import own_network
from tests.support.processes import Daemon, simulated, until

TRAJECTORY = ("/cmd/joint_trajectory", "trajectory_msgs/msg/JointTrajectory")
PATH = "{joint_names: [head_yaw], points: [{positions: [0.1], time_from_start: {sec: 1}}]}"
E_STOP = ("/bridge/estop_cmd", "std_msgs/msg/String")
WAITS = "Waiting for at least 1 matching subscription(s)"  # words of ros2cli
DISCOVERY = ("ROS_AUTOMATIC", "ROS_DOMAIN", "ROS_LOCALHOST", "ROS_STATIC", "RMW_", "FAST", "CYCLONEDDS_")
# By itself `ros2` ends 0.1 s after it published. On a busy machine 3 of 250 commands were lost (docs/ros.md).
STAYS = ("--keep-alive", "3")  # s
PATIENCE = 15.0  # s after which `ros2` counts as waiting
ANSWERED = 10.0  # s until the bridge reports what became of a command


def published(topic: tuple[str, str], text: str) -> dict[str, Any]:
    """Exit code (None: still waits) and output of `ros2 topic pub --once`."""
    command = ["ros2", "topic", "pub", "--once", *STAYS, *topic, text]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        with suppress(subprocess.TimeoutExpired):
            process.wait(PATIENCE)
        code = process.poll()
        process.kill()
        assert process.stdout is not None
        return {"code": code, "output": process.stdout.read()}


def answers(log: Path, topic: tuple[str, str]) -> int:
    """Commands of the topic that the bridge reports as accepted or done."""
    lines = [line for line in log.read_text().splitlines() if line.startswith(f"twindctl: {topic[0]}")]
    return sum(": accepted" in line or ": done" in line for line in lines)


def main(sockets: str, folder: str, count: str, *backend: str) -> None:
    """Start the bridge, publish each command `count` times, print the outcome as JSON."""
    log = Path(folder) / "bridge"
    words = [sys.executable, "-m", "twind.ctl.ctl_main", "--socket", sockets, "ros", *backend]
    outcomes = []
    with log.open("wb") as file:
        bridge = subprocess.Popen(words, stderr=file, stdout=file, stdin=subprocess.DEVNULL)
    try:
        until(lambda: "ROS 2 by" in log.read_text(), 30.0, "the first line of the bridge")
        for topic, text in ((TRAJECTORY, PATH), (E_STOP, "{data: settle}")):
            for _ in range(int(count)):
                before = answers(log, topic)
                outcome = published(topic, text) | {"topic": topic[0]}
                end = time.monotonic() + ANSWERED
                while outcome["code"] == 0 and answers(log, topic) == before and time.monotonic() < end:
                    time.sleep(0.02)
                outcomes.append(outcome | {"arrived": answers(log, topic) > before})
    finally:
        bridge.kill()
        bridge.wait(10.0)
    print(json.dumps({"outcomes": outcomes, "log": log.read_text()}))


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[Daemon]:
    with simulated(tmp_path / "run") as daemon:
        yield daemon


def tried(daemon: Daemon, folder: Path, count: int, *backend: str) -> dict[str, Any]:
    """Outcome of each command, and the log of the bridge."""
    if shutil.which("ros2") is None:
        pytest.skip("no `ros2` on the PATH")
    plain = {key: value for key, value in os.environ.items() if not key.startswith(DISCOVERY)}
    done = own_network.run(
        *(sys.executable, __file__, str(daemon.sockets), str(folder), str(count), *backend),
        seconds=60.0 + 2 * count * (PATIENCE + ANSWERED),
        environment=plain | {"ROS_LOG_DIR": str(folder)},
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_with_the_back_end_chosen_by_itself_each_command_published_once_arrives(
    daemon: Daemon, tmp_path: Path
) -> None:
    found = tried(daemon, tmp_path, 5)
    assert "ROS 2 by rclpy" in found["log"]
    lost = [each for each in found["outcomes"] if each["code"] != 0 or not each["arrived"]]
    assert not lost, (len(lost), len(found["outcomes"]), lost[:1], found["log"][-2000:])


def test_over_dds_a_command_published_once_waits_for_a_subscription_and_reports_that(
    daemon: Daemon, tmp_path: Path
) -> None:
    found = tried(daemon, tmp_path, 1, "--backend", "dds")
    assert [(each["code"], each["arrived"]) for each in found["outcomes"]] == [(None, False)] * 2, found
    assert all(WAITS in each["output"] for each in found["outcomes"]), found
    assert "takes no commands and no e-stop" in found["log"].splitlines()[0]
    assert daemon.status()["faults"] == []


if __name__ == "__main__":
    main(*sys.argv[1:])
