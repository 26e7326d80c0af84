"""The whole daemon with a humanoid of twenty virtual MX-28 on one bus, under a fake clock."""

import numpy as np

from tests.support.daemon_rig import MakeRig, Rig
from twind import link

DARWIN = "docs/examples/darwin/darwin.yaml"


def test_a_darwin_is_armed_moved_and_disarmed(make_rig: MakeRig) -> None:
    rig: Rig = make_rig(DARWIN)
    rig.arm()
    elbow = rig.names.index("l_elbow")
    before = rig.truth
    ticket = rig.submit(rig.path("l_elbow", [-0.5, -0.5], [1.0, 2.0]))
    rig.seconds(3.0)
    assert [reply.error for reply in rig.replies(ticket)][:1] == [None], rig.replies(ticket)
    moved = rig.truth - before
    assert abs(moved[elbow] + 0.5 + before[elbow]) < 0.01
    assert np.abs(np.delete(moved, elbow)).max() < 0.01
    assert rig.call(link.Disarm, ticks=1500).error is None
    rig.seconds(1.0)
    assert not any(each["torque"] for each in rig.virtual["main"].truth(rig.clock.now()))


def test_a_servo_that_an_alarm_unloads_is_reported(make_rig: MakeRig) -> None:
    rig: Rig = make_rig(DARWIN)
    rig.arm()
    rig.virtual["main"].faults.damage(6, 0x20)
    rig.seconds(0.5)
    assert rig.events("SERVO_ALERT"), [event.code for event in rig.events()]
    assert rig.virtual["main"].servos.get(5, "torque_limit") == 0
