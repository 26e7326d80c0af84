"""A soft arm with and without compensation of gravity, on real bytes and a body in MuJoCo."""

from pathlib import Path

import numpy as np
import pytest

from tests.support.body_rig import BodyRig, written_robot
from twind import link
from twind.config.yaml_tree import ConfigError
from twind.robot.arrays import Floats

pytestmark = pytest.mark.slow

READY = {"shoulder_lift": -0.3, "elbow_flex": 0.3}
ON = ("loop: {", "loop: {compensate_gravity: true, ")
BAD = {"FOLLOW_ERR", "STEP_LIMIT", "WIRE_CLAMP", "OUT_OF_LIMIT", "LEAD_LIMIT", "INTERNAL"}


def arm(folder: Path, *changes: tuple[str, str]) -> BodyRig:
    """so101 armed, stretched forward and at rest."""
    rig = BodyRig(written_robot(folder, "so101", *changes))
    rig.arm()
    rig.move_to(READY, 3.0)
    rig.seconds(2.0)
    return rig


def worst_step(rig: BodyRig, seconds: float) -> float:
    """Return the largest change of a goal on the wire in a tick, as a share of what its velocity allows."""
    limits: Floats = rig.loop.robot.limits.velocity * rig.loop.robot.period
    most = 0.0
    for _ in range(round(seconds / rig.loop.robot.period)):
        before = rig.loop.robot.written
        rig.ticks(1)
        after = rig.loop.robot.written
        most = max(most, float((np.abs(after - before) / limits).max()))
    return most


def test_a_soft_arm_sags_less_with_compensation_and_nothing_jumps(tmp_path: Path) -> None:
    rig = arm(tmp_path)
    sag = np.abs(rig.sag())
    rig.close()
    rig = arm(tmp_path, ON)
    left = np.abs(rig.sag())
    rig.lease()
    ticket = rig.send(link.EStop)
    step = worst_step(rig, 3.0)
    codes = {event.code for event in rig.events()}
    assert rig.replies(ticket)
    rig.close()
    assert sag.max() > 0.045
    assert left.max() < 0.01
    assert step <= 1.0 + 1e-6
    assert not codes & BAD


def test_a_robot_on_its_feet_cannot_ask_for_it(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="compensate_gravity: a robot on its feet"):
        BodyRig(written_robot(tmp_path, "so101", ON, ("support: fixed", "support: free")))
