"""LEAD_LIMIT bounds the goal on the wire: a stream leads no further with an offset against gravity."""

import math
from pathlib import Path

import pytest

from tests.support.body_rig import written_robot
from tests.support.daemon_rig import MakeRig, Rig
from twind import link
from twind.config.robot_file import load_robot
from twind.twin.dynamics import Dynamics

ON = ("loop: {", "loop: {compensate_gravity: true, ")
LOADED = {"shoulder_lift": 0.3, "elbow_flex": -0.5}  # rad
SPEED = 0.3  # rad/s
BRAKING = 0.01  # rad: the way to a stop from `SPEED`, and two ticks of it


@pytest.mark.parametrize("settled", [2.0, 0.0])  # s: the whole offset is there, or none of it yet
def test_a_stream_into_a_blocked_joint_leads_it_by_the_limit_beyond_its_sag(
    make_rig: MakeRig, tmp_path: Path, settled: float
) -> None:
    path = written_robot(tmp_path, "so101", ON)
    rig: Rig = make_rig(path, start=load_robot(path).poses["rest"] | LOADED)
    rig.arm()
    rig.seconds(settled)
    rig.lease()
    loop = rig.loop
    joint = rig.names.index("shoulder_lift")
    rig.virtual["main"].faults.lock(loop.robot.bound.file.joints[joint].id)
    ratings = loop.robot.description.ratings
    stiffness = ratings.stiffness[joint]
    sag = float(Dynamics(rig.one.binding).at_rest(loop.robot.measured.position)[joint] / stiffness)
    here = loop.robot.measured.position[joint]
    assert abs(sag) > 0.03
    assert loop.executor.reference is not None
    goal = float(loop.executor.reference.position[joint])
    speed = math.copysign(SPEED, sag)
    most = 0.0
    for tick in range(250):
        goal += speed * loop.robot.period
        now = rig.clock.now()
        rig.send(link.Setpoint, joints=[joint], positions=[goal], velocities=[speed], received=now)
        rig.ticks(1)
        if tick % 20 == 0:
            rig.lease()
        assert loop.robot.written is not None
        most = max(most, abs(float(loop.robot.written[joint]) - here))
    codes = {event.code for event in rig.events()}
    assert "LEAD_LIMIT" in codes
    assert "FOLLOW_ERR" not in codes
    assert most <= abs(sag) + ratings.lead[joint] + BRAKING
