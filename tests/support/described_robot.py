"""Other values in the description of a robot whose loop runs: limits, support, joints."""

from dataclasses import replace
from typing import Any


def redescribe(loop: Any, **changes: Any) -> None:
    """The loop's robot has these values from now on."""
    loop.robot.description = replace(loop.robot.description, **changes)
