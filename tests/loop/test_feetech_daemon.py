"""The whole daemon with an arm of six virtual STS3215, under a fake clock."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.support.built_in_copy import change, copy_built_in
from tests.support.daemon_rig import MakeRig, Rig
from twind import link
from twind.robot.arrays import Floats
from twind.twin.dynamics import Dynamics
from twind_drivers.virtual.servo_physics import FirstOrderPhysics

ARM = "so101"


def test_an_so101_is_armed_moved_and_disarmed(make_rig: MakeRig) -> None:
    rig: Rig = make_rig(ARM)
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
    arm = copy_built_in(ARM, tmp_path)
    change(arm, "    watchdog: none ", "    # ")
    rig: Rig = make_rig(str(arm))
    rig.seconds(1.0)
    rig.call(link.AcquireLease)
    reply = rig.call(link.Arm)
    assert reply.error is not None
    assert "no watchdog" in " ".join(event.message for event in rig.events())
    assert not any(each["torque"] for each in rig.virtual["main"].truth(rig.clock.now()))


def test_an_overload_is_reported_and_ends_with_its_cause(make_rig: MakeRig) -> None:
    rig: Rig = make_rig(ARM)
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


@pytest.mark.parametrize(
    ("changed", "code"),
    [({"homing_offset": 400}, "CALIB_MISMATCH"), ({"model_number": 2825}, "DEVICE_MISMATCH")],
)
def test_another_servo_in_the_place_of_one_is_not_armed_as_that(
    make_rig: MakeRig, changed: dict[str, int], code: str
) -> None:
    """No servo of this family reports a restart: one that was silent is identified anew."""
    rig: Rig = make_rig(ARM)
    rig.connect()
    bus = rig.virtual["main"]
    bus.faults.silence(3)
    rig.seconds(1.0)
    for name, value in changed.items():
        bus.servos.put(2, name, value)
    bus.faults.silence(3, False)
    rig.seconds(3.0)
    rig.lease()
    assert rig.call(link.Arm).error == "Refused"
    assert rig.events(code)
    assert not any(each["torque"] for each in bus.truth(rig.clock.now()))


def test_a_servo_that_lost_a_reply_or_two_is_not_identified_anew(make_rig: MakeRig) -> None:
    rig: Rig = make_rig(ARM)
    rig.connect()
    rig.virtual["main"].faults.corrupt(2, 3)
    rig.seconds(1.0)
    assert rig.loop.condition.state == "connected"
    assert len(rig.events("connected")) == 1


# ------------------------------------------------------------------------------------- no watchdog


class LoadedJoints(FirstOrderPhysics):
    """Servos that sag under the weight of the arm, by the stiffness that their P gain gives."""

    at_rest: Callable[[Floats], Floats] | None = None  # counts (m,) of sag at a position (m,)

    def set_goals(self, goal: Floats) -> None:
        super().set_goals(goal if self.at_rest is None else goal - self.at_rest(self.position))


def soft_arm(make_rig: MakeRig, folder: Path, gain: int) -> tuple[Rig, LoadedJoints]:
    """An arm whose servos have that P gain, and carry its weight."""
    arm = copy_built_in(ARM, folder)
    change(arm, "  sts3215:\n", f"  sts3215:\n    gains: {{p: {gain}}}\n")
    rig: Rig = make_rig(str(arm), muscles=LoadedJoints, start={"elbow_flex": 1.5})
    muscles = rig.virtual["main"].servos.muscles
    binding = rig.one.binding
    dynamics = Dynamics(binding)
    (bus,) = binding.joint_map.buses
    shift = muscles.position - (rig.truth[bus.joints] / bus.scale)

    def sag(counts: Floats) -> Floats:
        angle = np.zeros(len(bus.joints))
        angle[bus.joints] = (counts - shift) * bus.scale
        torque = dynamics.at_rest(angle) / binding.ratings.stiffness
        return torque[bus.joints] / bus.scale

    muscles.at_rest = sag
    return rig, muscles


def goals(rig: Rig) -> list[int]:
    return [each["goal"] for each in rig.virtual["main"].truth(rig.clock.now())]


@pytest.mark.parametrize("seconds", [5.0, pytest.param(600.0, marks=pytest.mark.campaign)])
def test_a_soft_joint_under_load_is_moved_and_held_without_creeping(
    make_rig: MakeRig, tmp_path: Path, seconds: float
) -> None:
    rig, _ = soft_arm(make_rig, tmp_path, 11)
    rig.arm()
    lift = rig.names.index("shoulder_lift")
    for joint, to in (("elbow_flex", 0.5), ("shoulder_lift", -0.05)):
        rig.lease()
        ticket = rig.submit(rig.path(joint, [to], [3.0]), more=True)
        rig.seconds(4.0)
        assert rig.replies(ticket)[-1].parameters["phase"] == "succeeded", rig.replies(ticket)[-1]
    commanded = goals(rig)
    place = rig.truth
    sag = rig.loop.robot.written[lift] - place[lift]
    assert 0.11 < abs(sag) < 0.2  # more than what slows a motion
    rig.seconds(seconds)
    assert goals(rig) == commanded
    assert np.abs(rig.truth - place).max() < 0.002
    assert rig.loop.torque.armed


def test_a_motion_waits_for_a_blocked_joint_and_goes_on(make_rig: MakeRig) -> None:
    rig: Rig = make_rig(ARM)
    rig.arm()
    roll = rig.names.index("wrist_roll")
    rig.virtual["main"].faults.lock(5)
    ticket = rig.submit(rig.path("wrist_roll", [1.0], [2.0]), more=True)
    rig.seconds(1.5)
    lead = rig.loop.robot.written[roll] - rig.truth[roll]
    assert 0.1 < lead <= 0.15
    waiting = rig.replies(ticket)[-1].parameters
    rig.virtual["main"].faults.free(5)
    rig.seconds(3.0)
    done = rig.replies(ticket)[-1].parameters
    assert done["phase"] == "succeeded"
    assert done["stretched_by"] == waiting["stretched_by"] == ["LEAD_LIMIT"]
    assert 0.5 < done["stretch"] < 2.0
    assert not rig.events("FOLLOW_ERR")


def test_a_motion_that_waits_in_vain_is_held_where_it_is(make_rig: MakeRig) -> None:
    rig: Rig = make_rig(ARM)
    rig.arm()
    rig.virtual["main"].faults.lock(5)
    ticket = rig.submit(rig.path("wrist_roll", [1.0], [2.0]), more=True)
    rig.seconds(4.0)
    ended = rig.replies(ticket)[-1].parameters
    assert ended["phase"] == "aborted"
    assert [each["code"] for each in ended["findings"]] == ["LEAD_LIMIT"]
    commanded = goals(rig)
    rig.seconds(1.0)
    assert goals(rig) == commanded
    assert rig.loop.torque.armed and not rig.loop.condition.latches


def test_arming_warns_of_each_joint_without_a_watchdog(make_rig: MakeRig) -> None:
    rig: Rig = make_rig(ARM)
    rig.connect()
    rig.call(link.AcquireLease)
    reply = rig.call(link.Arm)
    assert reply.error is None
    warned = reply.parameters["warnings"]
    assert [each["joint"] for each in warned] == list(range(6))
    assert "if the daemon dies, it drives on to its last goal" in warned[0]["message"]


@pytest.mark.parametrize("stalls", [(0.095,), (0.061, 0.06)])
def test_a_reply_lost_while_the_daemon_stood_still_is_no_silence_of_a_servo(
    make_rig: MakeRig, stalls: tuple[float, ...]
) -> None:
    """No goal left meanwhile that it could have missed; the motion is held, and may go on at once."""
    rig: Rig = make_rig(ARM)
    rig.arm()
    rig.submit(rig.path("wrist_roll", [0.5, 0.5], [1.0, 2.0]))
    rig.seconds(0.5)
    for stall in stalls:
        rig.clock.sleep_until(rig.clock.now() + stall)
        rig.virtual["main"].faults.silence(3, on=stall == stalls[0])
        rig.ticks(1)
    rig.virtual["main"].faults.clear()
    rig.seconds(0.5)
    assert not rig.loop.condition.latches
    rig.lease()
    ticket = rig.submit(rig.path("wrist_roll", [0.5], [1.0]))
    rig.ticks(5)
    assert rig.replies(ticket)[-1].parameters["phase"] == "accepted"


def test_a_joint_that_gets_no_goals_since_its_torque_once_read_off_is_latched(make_rig: MakeRig) -> None:
    """It would stand still while the robot counts as armed, and be released where it stands."""
    rig: Rig = make_rig(ARM)
    rig.arm()
    roll = rig.names.index("wrist_roll")
    servos = rig.virtual["main"].servos
    servos.put(roll, "torque_enable", 0)
    for _ in range(20):
        rig.ticks(1)
        if rig.loop.hardware.slow.torque[roll] == 0:
            break
    servos.put(roll, "torque_enable", 1)
    rig.seconds(0.3)
    assert rig.loop.hardware.slow.torque[roll] == 1
    assert "WATCHDOG_TRIPPED" in rig.loop.condition.latches
    assert rig.call(link.Disarm, ticks=1500).error is None
    assert rig.call(link.Reset).error is None
    rig.arm()
    assert not rig.loop.condition.latches
