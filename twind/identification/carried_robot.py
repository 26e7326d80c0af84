"""Requirement of motions that shake a robot, or take its torque: something other than its feet carries it."""

from collections.abc import Mapping
from typing import Any

from twind.command_line.verb import Rejected

CARRIED = ("fixed", "gantry")


def require_carried(robot: Mapping[str, Any], motion: str) -> None:
    """Require a support that is no foot, of a robot as GetRobot describes it. Raises Rejected.

    `motion`: what would make it fall. The gate judges no balance of a motion, so it would let it pass.
    """
    support = robot.get("support")
    if support not in CARRIED:
        raise Rejected(
            f"{robot['name']} has support {support}: on its own feet {motion} would make it fall; hang it on "
            "a gantry or fix its base, state that as `support` in its robot file, then restart the daemon"
        )
