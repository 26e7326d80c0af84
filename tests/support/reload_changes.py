"""Narrower limits for one joint, and the objects that a reload replaces."""

from typing import Any

from tests.support.daemon_rig import Rig
from twind import link

YAW = "joints.head_yaw"
NARROW = {f"{YAW}.limits_rad": [-0.3, 0.3], f"{YAW}.velocity_limit_rad_s": 0.5}


def codes(reply: link.Reply) -> list[str]:
    return [finding["code"] for finding in reply.parameters["findings"]]


def held(rig: Rig) -> tuple[Any, ...]:
    """Everything that a change replaces, as objects: the same ones mean that nothing was changed."""
    loop = rig.loop
    ports = [each for port in loop.hardware.ports for each in (port.writer, port.enabler)]
    return (
        loop.robot.description,
        loop.commands.gate_input.thresholds,
        loop.executor.limits,
        loop.robot.outlook,
        *ports,
    )
