"""The simulation beside a compensated robot stands where commands are, without their offset."""

from pathlib import Path

import numpy as np
import pytest

from tests.support.body_rig import written_robot
from tests.support.daemon_rig import MakeRig, Rig
from twind import link
from twind.config.robot_file import load_robot
from twind.loop.ipc.call_outcome import CallReply
from twind.loop.procedures import arming
from twind.loop.procedures.procedure_runner import Procedure

ON = ("loop: {", "loop: {compensate_gravity: true, ")


def arm_at_once(*_: object) -> Procedure:
    """Arm a robot that is armed already; the goals on the wire keep their offset."""
    return CallReply({})
    yield


def test_after_arming_the_simulation_begins_at_the_commanded_pose(
    make_rig: MakeRig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = written_robot(tmp_path, "so101", ON)
    loaded = {"shoulder_lift": 0.3, "elbow_flex": -0.5}
    rig: Rig = make_rig(path, start=load_robot(path).poses["rest"] | loaded)
    rig.arm()
    rig.seconds(1.5)
    monkeypatch.setattr(arming, "arm", arm_at_once)
    assert rig.call(link.Arm).error is None
    robot = rig.loop.robot
    assert robot.written is not None and robot.commanded is not None
    assert np.abs(robot.written - robot.commanded).max() > 0.03
    assert robot.simulated.position == pytest.approx(robot.commanded, abs=0.01)
