"""The robot file of a running daemon, read again by a client on the same machine: the same one, or none."""

from collections.abc import Mapping
from typing import Any

from twind.config.robot_file import RobotFile, load_robot
from twind.config.yaml_tree import ConfigError
from twind.exceptions import InvalidInput


def robot_file_of(answer: Mapping[str, Any]) -> RobotFile:
    """Load the robot file of an answer of `GetRobot`. Raises InvalidInput: unreadable here, or changed."""
    try:
        robot = load_robot(str(answer["robot"]["path"]))
    except (ConfigError, OSError) as error:
        raise InvalidInput(f"the daemon's robot file cannot be read here: {error}") from None
    require_same(answer, robot)
    return robot


def require_same(answer: Mapping[str, Any], robot: RobotFile) -> None:
    """Raises InvalidInput unless the daemon runs this very robot file and model."""
    theirs = answer["robot"]
    if theirs["text_sha256"] != robot.text_sha256:
        raise InvalidInput(
            f"the daemon runs {theirs['name']} from {theirs['path']}, not as {robot.path} says now: "
            "name that robot, or restart or reload the daemon"
        )
    if theirs["mjcf"] != robot.mjcf:
        raise InvalidInput(f"the model {robot.mjcf_path} has changed since the daemon read it: restart it")
