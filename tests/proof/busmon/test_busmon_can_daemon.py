"""The real daemon on two CAN legs under the monitor, in process: a life breaks no rule, a lie is caught."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.proof.busmon.can.monitor import CanMonitor
from tests.proof.busmon.watched import Watched
from tests.support.daemon_rig import Rig
from twind import link
from twind.robot.modes import Mode, RobotState
from twind.virtual.virtual_robot_spec import save

LEGS = ("l_leg", "r_leg")


def watched(folder: Path, **how: Any) -> tuple[Rig, Watched]:
    rig = Rig("h24-mixed", **how)
    save(rig.made, folder / "calibration.yaml")
    return rig, Watched(rig, folder / "calibration.yaml")


def rules(found: Watched) -> set[str]:
    return {each.rule for one in found.monitors.values() for each in one.violations}


def test_arming_moving_stopping_and_letting_go_break_no_rule(tmp_path: Path) -> None:
    rig, found = watched(tmp_path)
    rig.arm()
    rig.submit(rig.path("l_knee", [0.4], [0.8]))
    rig.seconds(0.4)
    rig.send(link.EStop, level="cut")
    rig.seconds(0.3)
    found.look()
    found.verdict()
    assert not any(node["torque"] for leg in LEGS for node in rig.virtual[leg].truth(rig.clock.now()))
    for leg in LEGS:
        monitor = found.monitors[leg]
        assert isinstance(monitor, CanMonitor)
        assert monitor.goal_packets > 40
        assert monitor.sent_packets > 500
    rig.close()


def test_a_mirror_writes_nothing_on_can(tmp_path: Path) -> None:
    rig, found = watched(tmp_path, mode=Mode.MIRROR)
    rig.seconds(0.6)
    found.look()
    found.verdict()
    assert all(found.monitors[leg].sent_packets > 50 for leg in LEGS)
    assert all(found.monitors[leg].goal_packets == 0 for leg in LEGS)
    rig.close()


@pytest.mark.parametrize("lie", [0.05, -0.05])
def test_a_daemon_whose_goals_are_moved_on_their_way_is_caught(tmp_path: Path, lie: float) -> None:
    """The last hand that touches them adds to one motor's position field: W3 says so."""
    rig, found = watched(tmp_path)
    rig.arm()
    bus = rig.virtual["l_leg"]
    heard = bus.take_host_frames
    moved = round(lie * 65535 / 25.0)

    def touched(frames: Any, now: float) -> int:
        frames = frames.copy()
        goal = (frames["id"] == 4) & (frames["data"][:, 3] & 15 | frames["data"][:, 4] != 0)
        data = frames["data"]
        goal &= data[:, 0] != 0xFF
        field = data[:, 0].astype(np.int64) * 256 + data[:, 1] + np.where(goal, moved, 0)
        data[:, 0] = field // 256
        data[:, 1] = field % 256
        return int(heard(frames, now))

    assert not found.monitors["l_leg"].violations
    bus.take_host_frames = touched
    rig.ticks(3)
    assert rig.loop.condition.state in (RobotState.ARMED, RobotState.FAULT)
    assert "W3" in rules(found)
    rig.close()
