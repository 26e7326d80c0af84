"""The whole daemon with an arm of six virtual STS3215, under a fake clock."""

from pathlib import Path

import numpy as np

from tests.support.daemon_rig import MakeRig, Rig
from twind import link

ARM = Path("docs/examples/so101/so101.yaml")


def test_an_so101_is_armed_moved_and_disarmed(make_rig: MakeRig) -> None:
    rig: Rig = make_rig(str(ARM))
    rig.arm()
    roll = rig.names.index("wrist_roll")
    before = rig.truth
    ticket = rig.submit(rig.path("wrist_roll", [0.5, 0.5], [1.0, 2.0]))
    rig.seconds(3.0)
    assert [reply.error for reply in rig.replies(ticket)][:1] == [None], rig.replies(ticket)
    moved = rig.truth - before
    assert abs(moved[roll] - 0.5 + before[roll]) < 0.01
    assert np.abs(np.delete(moved, roll)).max() < 0.01
    assert rig.call(link.Disarm, ticks=1500).error is None
    rig.seconds(1.0)
    assert not any(each["torque"] for each in rig.virtual["main"].truth(rig.clock.now()))


def test_it_is_not_armed_unless_the_file_says_that_there_is_no_watchdog(
    make_rig: MakeRig, tmp_path: Path
) -> None:
    text = ARM.read_text().replace("    watchdog: none ", "    # ")
    (tmp_path / "so101.yaml").write_text(text)
    (tmp_path / "so101.xml").write_text(ARM.with_suffix(".xml").read_text())
    rig: Rig = make_rig(str(tmp_path / "so101.yaml"))
    rig.seconds(1.0)
    rig.call(link.AcquireLease)
    reply = rig.call(link.Arm)
    assert reply.error is not None
    assert "no watchdog" in " ".join(event.message for event in rig.events())
    assert not any(each["torque"] for each in rig.virtual["main"].truth(rig.clock.now()))


def test_an_overload_is_reported_and_ends_with_its_cause(make_rig: MakeRig) -> None:
    rig: Rig = make_rig(str(ARM))
    rig.arm()
    rig.virtual["main"].faults.damage(3, 0x20)
    rig.seconds(0.5)
    assert rig.events("SERVO_ALERT"), [event.code for event in rig.events()]


def test_a_biped_of_14_servos_is_armed_moved_and_armed_again_after_a_replug(make_rig: MakeRig) -> None:
    rig: Rig = make_rig("docs/examples/biped14/biped14.yaml")
    rig.arm()
    before = rig.truth
    ticket = rig.submit(rig.path("l_knee", [0.8, 0.8], [1.0, 2.0]))
    rig.seconds(3.0)
    assert [reply.error for reply in rig.replies(ticket)][:1] == [None], rig.replies(ticket)
    assert abs((rig.truth - before)[rig.names.index("l_knee")] - 0.8) < 0.05
    rig.virtual["main"].faults.unplug()
    rig.seconds(1.0)
    rig.virtual["main"].faults.replug()
    rig.seconds(3.0)
    rig.lease()
    rig.lease()
    rig.call(link.Disarm, ticks=2500)
    assert not any(each["torque"] for each in rig.virtual["main"].truth(rig.clock.now()))
    reset = rig.call(link.Reset)
    assert reset.error is None, reset
    rig.arm()
