"""A daemon of every built-in robot but h24, with MuJoCo's muscles, under a fake clock."""

import numpy as np
import pytest

from tests.support.daemon_rig import MakeRig
from tests.support.mujoco_servo_rig import WholeBodyRig
from twind import link
from twind.ctl.offline_check import motions_of

ROBOTS = ("pan-tilt", "so101", "so101-leader", "koch", "quadruped12")


@pytest.mark.parametrize("name", ROBOTS)
def test_a_limp_robot_is_armed_moved_and_lowered(make_rig: MakeRig, name: str) -> None:
    rig: WholeBodyRig = make_rig(name, kind=WholeBodyRig)
    rig.arm()  # where its weight has taken it
    paths, _ = motions_of(rig.robot)
    path = min(paths.values(), key=lambda each: float(each.time[-1]))
    ticket = rig.submit(path, more=True)
    worst = 0.0
    far = 0.0
    for _ in range(round((float(path.time[-1]) + 1.0) * rig.robot.rate_hz)):
        rig.ticks(1)
        measured = rig.loop.robot.measured.position
        worst = max(worst, float(np.abs(rig.loop.robot.written - measured).max()))
        far = max(far, float(np.abs(measured - rig.one.binding.rest).max()))
    last = rig.replies(ticket)[-1].parameters
    assert last["phase"] == "succeeded", last
    assert last["stretch"] < 0.1, last
    assert far > 0.3
    assert worst < 0.2, worst
    rig.lease()
    assert rig.call(link.Disarm, ticks=1500).error is None
    assert not any(each["torque"] for each in rig.virtual["main"].truth(rig.clock.now()))
