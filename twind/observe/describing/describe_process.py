"""Process of the ROS bridge that describes the robot: the answer of `GetRobot` in, URDF and joints out, JSON.

The bridge itself may run under another Python, without MuJoCo.
"""

import json
import os
import sys

from twind.exceptions import InvalidInput
from twind.observe.describing.robot_frames import robot_tree
from twind.observe.describing.urdf_writer import urdf_text
from twind.twin.model_from_text import compile_model


def main() -> int:
    """Return the exit code; 2: standard error has the reason."""
    description = json.load(sys.stdin)
    robot = description["robot"]
    try:
        model, _ = compile_model(description["mjcf"], os.path.dirname(robot["mjcf_path"]))
        tree = robot_tree(model, robot)
    except InvalidInput as error:
        print(error, file=sys.stderr)
        return 2
    json.dump({"urdf": urdf_text(tree, robot), "joints": tree.table()}, sys.stdout)
    return 0


if __name__ == "__main__":
    sys.exit(main())
