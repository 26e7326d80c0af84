"""The whole daemon with an arm of XL-320, or of PRO -R, under a fake clock."""

from pathlib import Path

import pytest

from tests.support.daemon_rig import MakeRig, Rig
from tests.support.derived_arm import serial_arm_of
from twind import link

KIND = "dynamixel2_unwatched"
ACCEPTED = "watchdog: none"


@pytest.mark.parametrize("device", ["XL320", "H42-20-S300-R"])
def test_an_arm_is_armed_moved_and_keeps_its_goal_when_the_daemon_dies(
    make_rig: MakeRig, tmp_path: Path, device: str
) -> None:
    rig: Rig = make_rig(serial_arm_of(tmp_path, KIND, device, ACCEPTED))
    rig.arm()
    ticket = rig.submit(rig.path("elbow", [-0.5, -0.5], [0.7, 1.2]))
    rig.seconds(0.5)
    assert [reply.error for reply in rig.replies(ticket)][:1] == [None], rig.replies(ticket)
    elbow = rig.names.index("elbow")
    here = rig.truth[elbow]
    assert -0.45 < here < -0.1, "in the middle of a motion"
    rig.clock.sleep_until(rig.clock.now() + 2.0)  # nobody writes or reads
    rig.virtual["main"].advance(rig.clock.now())
    states = rig.virtual["main"].truth(rig.clock.now())
    assert all(each["torque"] for each in states)
    assert abs(rig.truth[elbow] - here) <= 0.15, "no further than the bounded lead"


def test_without_a_word_on_the_watchdog_arming_is_refused(make_rig: MakeRig, tmp_path: Path) -> None:
    rig: Rig = make_rig(serial_arm_of(tmp_path, KIND, "XL320", "torque_limit: 800"))
    rig.seconds(1.0)
    reply = rig.call(link.Arm, ticks=300)
    assert reply.error is not None
    assert "watchdog: none" in str(reply), reply
