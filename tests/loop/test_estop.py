"""E-stops that meet another e-stop, on real bytes under a fake clock: what each answer rests on."""

from tests.support.daemon_rig import MakeRig
from twind import link
from twind.robot.modes import Mode
from twind.robot.recovery_steps import next_text


def test_a_cut_after_a_settling_stop_is_not_answered_before_torque_is_read_back(make_rig: MakeRig) -> None:
    """The first stop's confirmation is not the second's: one servo is silent by then."""
    rig = make_rig()
    rig.arm()
    rig.submit(rig.path("head_yaw", [0.4], [1.0]))
    rig.ticks(50)
    first = rig.call(link.EStop)
    assert (first.parameters["torque_off"], first.parameters["done"]) == (False, False)
    rig.virtual["main"].faults.silence(5)
    second = rig.send(link.EStop, client=9, level="cut")
    rig.ticks(50)
    assert not rig.replies(second)
    rig.seconds(2.0)
    reply = rig.replies(second)[-1]
    assert reply.parameters["torque_off"] is not True
    assert rig.events("TORQUE_MISMATCH")


def test_a_settling_stop_after_a_reset_is_not_answered_before_its_own_goals_are_read_back(
    make_rig: MakeRig,
) -> None:
    rig = make_rig()
    rig.arm()
    rig.call(link.EStop, level="settle")
    rig.seconds(6.0)
    assert not rig.register("torque_enable").any()
    assert rig.call(link.Reset).error is None
    rig.lease()
    assert rig.call(link.Arm).error is None
    rig.virtual["main"].faults.silence(5)
    second = rig.send(link.EStop, level="settle")
    rig.ticks(20)
    assert not rig.replies(second)
    rig.seconds(8.0)
    assert rig.replies(second)[-1].parameters["torque_off"] is not True


def test_a_second_settling_stop_is_answered_at_once_by_what_the_first_has_read_back(
    make_rig: MakeRig,
) -> None:
    rig = make_rig()
    rig.arm()
    rig.submit(rig.path("head_yaw", [0.4], [1.0]))
    rig.ticks(50)
    assert rig.call(link.EStop, level="settle").parameters["done"] is False
    second = rig.send(link.EStop, client=9, level="settle")
    rig.ticks(2)
    assert rig.replies(second)[0].parameters["torque_off"] is False


def test_a_settling_stop_after_a_cut_leaves_the_cut_for_a_bus_that_comes_back(make_rig: MakeRig) -> None:
    """The joints of that bus are let go where they are: a way to the rest pose would move them."""
    rig = make_rig("h24-split")
    rig.arm()
    rig.submit(rig.path("head_yaw", [0.4], [0.5]))
    rig.seconds(1.0)
    upper = rig.virtual["upper"]
    upper.faults.unplug()
    rig.ticks(3)
    rig.call(link.EStop, level="cut")
    rig.call(link.EStop, level="settle")
    before = rig.truth
    assert upper.servos["torque_enable"].any()
    upper.faults.replug()
    rig.seconds(4.0)
    assert not rig.register("torque_enable").any()
    assert abs(rig.truth - before).max() < 0.02


def test_reset_and_disarm_during_the_lowering_of_an_estop_are_refused_with_the_remedy_to_wait(
    make_rig: MakeRig,
) -> None:
    rig = make_rig()
    rig.arm()
    rig.call(link.EStop, level="settle")
    reset = rig.call(link.Reset)
    assert reset.error == "WrongState"
    assert "wait until torque is off" in reset.parameters["allowed"][0]
    rig.lease()
    disarm = rig.call(link.Disarm)
    assert disarm.error == "Busy"
    assert "wait until torque is off" in disarm.parameters["what"]
    rig.seconds(6.0)
    assert rig.call(link.Reset).error is None


def test_an_e_stop_in_mirror_with_torque_that_was_found_on_runs_once_the_mode_is_live(
    make_rig: MakeRig,
) -> None:
    """Mirror writes nothing; disarm and reset need live, which must not need them."""
    rig = make_rig("koch")
    rig.arm()
    rig.loop = rig.born(Mode.MIRROR)
    rig.connect()
    reply = rig.call(link.EStop)
    assert (reply.parameters["torque_off"], reply.parameters["done"]) == (False, True)
    assert rig.register("torque_enable").all()
    steps = next_text("estop", ["ESTOP"], torque_on=True, live=False)
    assert steps.startswith("next: `twindctl mode live`, then wait until torque is off")
    assert rig.call(link.SetMode, mode="live").error is None
    rig.seconds(8.0)
    assert not rig.register("torque_enable").any()
    assert rig.call(link.Reset).error is None
    assert rig.loop.condition.state == "connected"


def test_a_robot_unplugged_under_torque_and_brought_back_stays_in_live_where_it_is_disarmed(
    make_rig: MakeRig,
) -> None:
    rig = make_rig("koch")
    rig.arm()
    rig.virtual["main"].faults.unplug()
    rig.seconds(1.0)
    assert rig.call(link.SetMode, mode="mirror").parameters["findings"][0]["code"] == "MODE_DENIES"
    rig.virtual["main"].faults.replug()
    rig.seconds(2.0)
    assert rig.register("torque_enable").all()
    assert rig.call(link.Disarm, ticks=1500).error is None
    assert rig.call(link.Reset).error is None


def test_torque_that_was_found_on_beside_a_missing_servo_is_switched_off_in_live(make_rig: MakeRig) -> None:
    rig = make_rig("koch")
    rig.arm()
    rig.virtual["main"].faults.silence(2)
    rig.loop = rig.born(Mode.MIRROR)
    rig.seconds(3.0)
    assert rig.loop.condition.state == "identifying"
    assert rig.call(link.SetMode, mode="live").error is None
    rig.call(link.Disarm, ticks=1500)
    assert rig.register("torque_enable").tolist() == [0, 1, 0, 0, 0, 0]
