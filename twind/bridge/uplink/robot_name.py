"""Name of a robot on the network. Standard library only."""

import re
from collections.abc import Mapping
from typing import Any

from twind.bridge.zenoh.zenoh_keys import LONGEST


def robot_name(status: Mapping[str, Any], parameters: Mapping[str, Any]) -> str:
    """The individual's name, else the robot file's, as one chunk of a key: other characters become `-`.

    `status`: of GetStatus; `parameters`: of GetParameters.
    """
    name = str(parameters.get("individual") or status["robot"])
    return re.sub(r"[^A-Za-z0-9_.-]", "-", name).lstrip(".")[:LONGEST] or "robot"
