"""A robot whose measured travel ends before its rest pose is lowered all the same."""

from dataclasses import replace

import numpy as np

from tests.support.daemon_rig import Rig, known_calibration
from twind import link
from twind.config.calibration_file import Calibration
from twind.config.counts import ticks_of
from twind.config.robot_file import load_robot
from twind.robot.modes import RobotState

H24 = load_robot("h24")
JOINT = "head_yaw"
END = 0.1  # rad, of the measured travel; the rest pose is 0


def measured_short() -> Calibration:
    """A calibration in which the travel of one joint was not swept down to its rest pose."""
    known = known_calibration("h24")
    joint = next(each for each in H24.joints if each.name == JOINT)
    entry = known.by_name[JOINT]
    end = ticks_of(joint, entry.zero_ticks, END)
    inside = ticks_of(joint, entry.zero_ticks, 1.0)
    low, high = entry.sweep_ticks
    short = replace(entry, sweep_ticks=(end, high) if inside > end else (low, end))
    return replace(known, joints=tuple(short if each is entry else each for each in known.joints))


def test_a_robot_is_lowered_although_one_joint_cannot_reach_its_rest_pose() -> None:
    rig = Rig("h24", calibrated=measured_short(), start={JOINT: 0.5, "l_shoulder_pitch": 0.4})
    limits = rig.one.binding.limits
    place = rig.names.index(JOINT)
    assert limits.hard_lower[place] > 0.05
    rig.arm()
    rig.call(link.Disarm)
    assert rig.loop.condition.state is RobotState.CONNECTED
    assert not {event.code for event in rig.events()} & {"WIRE_CLAMP", "DAMP", "SETTLE"}
    rests = np.zeros(len(rig.names))
    rests[place] = limits.lower[place]
    assert np.abs(rig.loop.robot.measured.position - rests).max() < 0.02
    rig.close()
