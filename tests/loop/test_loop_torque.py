"""Arming, release and e-stop: procedures of the tick, on real bytes under a fake clock."""

import numpy as np
import pytest

from tests.support.daemon_rig import MakeRig, Rig
from twind import link
from twind.loop.procedures.internal_faults import inhibit
from twind.loop.procedures.torque_readback import torque_inherited, torque_known, torque_off
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode, RobotState

pytestmark = pytest.mark.slow  # whole lives of the loop: half of all fast tests' time


def codes(reply: link.Reply) -> list[str]:
    assert reply.error == "Refused", reply
    return [finding["code"] for finding in reply.parameters["findings"]]


def test_nothing_moves_and_torque_never_changes_because_a_daemon_started(live: Rig) -> None:
    before = live.truth
    live.seconds(2.0)
    assert live.loop.condition.state is RobotState.CONNECTED
    assert (live.register("torque_enable") == 0).all()
    assert np.array_equal(live.truth, before)


def test_arming_in_mirror_is_refused_because_nothing_there_can_write(make_rig: MakeRig) -> None:
    rig = make_rig(mode=Mode.MIRROR)
    rig.connect()
    rig.lease()
    assert codes(rig.call(link.Arm)) == ["MODE_DENIES"]
    assert rig.loop.hardware.writers == []


def test_disarming_goes_to_the_rest_pose_before_torque_goes_off(armed: Rig) -> None:
    armed.submit(armed.path("head_yaw", [0.4], [1.0]))
    armed.seconds(1.5)
    assert armed.truth[0] == pytest.approx(0.4, abs=0.05)
    reply = armed.call(link.Disarm, ticks=800)
    assert reply.parameters["state"] == "connected"
    assert np.abs(armed.truth - armed.loop.robot.rest).max() < 0.05
    assert (armed.register("torque_enable") == 0).all()


def test_estop_level_cut_answers_after_torque_was_read_back_off(armed: Rig) -> None:
    armed.submit(armed.path("head_yaw", [0.4], [1.0]))
    armed.ticks(30)
    ticket = armed.send(link.EStop, client=9, level="cut")
    for _ in range(20):
        armed.ticks(1)
        if armed.replies(ticket):
            break
    reply = armed.replies(ticket)[0]
    assert reply.parameters == {"state": "estop", "torque_off": True, "done": True}
    assert (armed.register("torque_enable") == 0).all()


def test_an_e_stop_of_level_settle_decelerates_lowers_and_switches_torque_off(armed: Rig) -> None:
    armed.submit(armed.path("head_yaw", [0.4], [1.0]))
    armed.ticks(30)
    ticket = armed.send(link.EStop, client=9, more=True)
    armed.ticks(10)
    first = armed.replies(ticket)[0]
    assert first.continues and first.parameters["torque_off"] is False
    armed.seconds(6.0)
    last = armed.replies(ticket)[-1]
    assert last.parameters == {"state": "estop", "torque_off": True, "done": True}
    assert np.abs(armed.truth - armed.loop.robot.rest).max() < 0.05


def test_a_cut_overtakes_a_settling_estop(armed: Rig) -> None:
    armed.submit(armed.path("head_yaw", [0.4], [1.0]))
    armed.seconds(1.5)
    armed.send(link.EStop, level="settle")
    armed.ticks(20)
    assert armed.call(link.EStop, ticks=20, level="cut").parameters["torque_off"] is True


def test_after_an_estop_only_a_reset_and_a_new_arm_bring_motion_back(armed: Rig) -> None:
    armed.call(link.EStop, level="cut")
    armed.lease()
    assert "ESTOP_LATCHED" in codes(armed.call(link.Arm))
    assert armed.call(link.Reset).parameters["state"] == "connected"
    assert (armed.register("torque_enable") == 0).all()
    assert armed.call(link.Arm).error is None


def test_torque_found_on_is_reported_as_inherited_and_left_until_arming(make_rig: MakeRig) -> None:
    rig = make_rig()
    bus = rig.virtual["main"]
    for row in range(24):
        bus.servos.torque(row, True)
    rig.connect()
    rig.seconds(2.0)
    assert torque_inherited(rig.loop) is True
    assert rig.events("TORQUE_INHERITED")
    assert (rig.register("bus_watchdog") == 0).all()
    before = rig.counts
    rig.lease()
    assert rig.call(link.Arm).error is None
    assert np.abs(rig.counts - before).max() <= 2


def test_torque_found_on_at_the_very_edge_of_the_travel_is_taken_over_and_lowered(make_rig: MakeRig) -> None:
    """The hard limit itself may round to a count that no goal may have: the nearest one that may is held."""
    rig = make_rig(start={"l_elbow": 0.15})
    place = rig.names.index("l_elbow")
    assert rig.loop.robot.limits.hard_upper[place] == pytest.approx(0.15)
    for row in range(24):
        rig.virtual["main"].servos.torque(row, True)
    rig.connect()
    rig.seconds(0.5)
    assert rig.call(link.Disarm, ticks=900).parameters["state"] == "connected"
    assert not rig.events("WIRE_CLAMP")
    assert abs(rig.truth[place]) < 0.05  # it went the way to the rest pose
    assert (rig.register("torque_enable") == 0).all()


def test_sigterm_lowers_the_robot_and_then_ends(armed: Rig) -> None:
    armed.submit(armed.path("head_yaw", [0.4], [1.0]))
    armed.seconds(1.5)
    armed.loop.condition.stop_wanted = True
    for _ in range(800):
        if armed.loop.condition.finished:
            break
        armed.ticks(1)
    assert armed.loop.condition.finished
    assert np.abs(armed.truth - armed.loop.robot.rest).max() < 0.05
    assert (armed.register("torque_enable") == 0).all()


def test_sigterm_leaves_inherited_torque_as_it_was_found(make_rig: MakeRig) -> None:
    rig = make_rig()
    for row in range(24):
        rig.virtual["main"].servos.torque(row, True)
    rig.connect()
    rig.loop.condition.stop_wanted = True
    rig.ticks(5)
    assert rig.loop.condition.finished
    assert (rig.register("torque_enable") == 1).all()


@pytest.mark.parametrize("moment", [1, 2, 4, 10, 60])
def test_sigterm_completes_a_disarm_of_torque_that_was_found(make_rig: MakeRig, moment: int) -> None:
    rig = make_rig(start={"head_yaw": 0.4})  # so that there is a way
    for row in range(24):
        rig.virtual["main"].servos.torque(row, True)
    rig.connect()
    rig.send(link.Disarm)
    rig.ticks(moment)
    assert rig.loop.condition.state is RobotState.SETTLING
    rig.loop.condition.stop_wanted = True
    for _ in range(800):
        if rig.loop.condition.finished:
            break
        rig.ticks(1)
    assert rig.loop.condition.finished
    assert rig.loop.condition.state is RobotState.CONNECTED
    assert np.abs(rig.truth - rig.loop.robot.rest).max() < 0.05
    assert (rig.register("torque_enable") == 0).all()


def test_sigterm_completes_the_disarm_of_an_inhibited_robot(armed: Rig) -> None:
    inhibit(armed.loop, Finding(ReasonCode.INTERNAL), armed.clock.now())
    armed.ticks(50)
    armed.send(link.Disarm)
    armed.ticks(1)
    armed.loop.condition.stop_wanted = True
    armed.ticks(50)
    assert armed.loop.condition.finished
    assert (armed.register("torque_enable") == 0).all()


def test_an_inhibited_robot_can_be_let_go_by_its_operator(armed: Rig) -> None:
    inhibit(armed.loop, Finding(ReasonCode.INTERNAL), armed.clock.now())
    armed.ticks(5)
    assert (armed.register("torque_enable") == 1).all()
    reply = armed.call(link.Disarm, ticks=50)
    assert (reply.error, reply.parameters["state"]) == (None, "inhibited")
    assert (armed.register("torque_enable") == 0).all()
    assert armed.call(link.Reset).parameters["state"] == "identifying"
    armed.connect()  # everybody was asked anew who they are
    armed.seconds(0.6)  # half a second of good latency (LATENCY_BLOCK)
    armed.lease()
    assert armed.call(link.Arm).error is None


def test_torque_that_arming_switches_on_goes_off_when_writing_is_inhibited(live: Rig) -> None:
    live.connect()
    live.lease()
    ticket = live.send(link.Arm)
    while not live.register("torque_enable").any():
        live.ticks(1)
    assert live.loop.condition.state is RobotState.ARMING
    inhibit(live.loop, Finding(ReasonCode.INTERNAL, message="a bug"), live.clock.now())
    live.ticks(50)
    assert (live.register("torque_enable") == 0).all()
    assert live.loop.condition.state is RobotState.INHIBITED and not live.loop.torque.energising
    what = live.replies(ticket)[-1].parameters["what"]
    assert what == "arming was ended by INTERNAL: a bug"


def test_torque_that_was_found_on_stays_when_writing_is_inhibited_during_its_arming(armed: Rig) -> None:
    armed.loop = armed.born(Mode.LIVE)
    armed.connect()
    armed.lease()
    armed.send(link.Arm)
    while armed.loop.condition.state is not RobotState.ARMING:
        armed.ticks(1)
    inhibit(armed.loop, Finding(ReasonCode.INTERNAL), armed.clock.now())
    armed.ticks(50)
    assert (armed.register("torque_enable") == 1).all()
    assert torque_inherited(armed.loop)


def test_sigterm_ends_an_inhibited_daemon_and_writes_nothing(armed: Rig) -> None:
    inhibit(armed.loop, Finding(ReasonCode.INTERNAL), armed.clock.now())
    armed.loop.condition.stop_wanted = True
    armed.ticks(5)
    assert armed.loop.condition.finished
    assert (armed.register("torque_enable") == 1).all()


MOMENTS = range(1, 18)  # ticks after the call: before torque, the tick in which it comes on, after it


@pytest.mark.parametrize("level", ["settle", "cut"])
def test_an_e_stop_at_any_moment_of_arming_reports_the_true_torque_state(level: str) -> None:
    for moment in MOMENTS:
        rig = Rig()
        rig.connect()
        rig.lease()
        rig.send(link.Arm)
        rig.ticks(moment)
        reply = rig.call(link.EStop, level=level)
        on = (rig.register("torque_enable") == 1).any()
        assert reply.parameters["torque_off"] is not on, (moment, reply)
        rig.seconds(2.0)
        assert (rig.register("torque_enable") == 0).all(), moment
        rig.close()


def test_disarming_at_any_moment_of_arming_ends_connected_without_torque() -> None:
    for moment in MOMENTS:
        rig = Rig()
        rig.connect()
        rig.lease()
        rig.send(link.Arm)
        rig.ticks(moment)
        assert rig.call(link.Disarm, ticks=900).parameters["state"] == "connected", moment
        assert (rig.register("torque_enable") == 0).all(), moment
        rig.close()


@pytest.mark.parametrize("found_on", [False, True])
def test_sigterm_at_any_moment_of_arming_leaves_no_torque_but_what_was_found(found_on: bool) -> None:
    for moment in MOMENTS[:16]:
        rig = Rig()
        if found_on:
            for row in range(24):
                rig.virtual["main"].servos.torque(row, True)
        rig.connect()
        rig.lease()
        rig.send(link.Arm)
        rig.ticks(moment)
        assert rig.loop.condition.state is RobotState.ARMING
        rig.loop.condition.stop_wanted = True
        rig.ticks(10)
        assert rig.loop.condition.finished
        assert (rig.register("torque_enable") == int(found_on)).all(), moment
        rig.close()


def test_a_bus_that_goes_at_any_moment_of_arming_leaves_no_torque_on_the_other() -> None:
    for moment in MOMENTS[:16]:
        rig = Rig("h24-split")
        rig.connect()
        rig.lease()
        rig.send(link.Arm)
        rig.ticks(moment)
        rig.virtual["upper"].faults.unplug()
        rig.seconds(1.0)
        assert not any(rig.virtual["lower"].servos["torque_enable"]), moment
        rig.close()


def test_inherited_torque_is_not_reported_off_in_mirror_and_can_be_switched_off_in_live(
    make_rig: MakeRig,
) -> None:
    rig = make_rig(mode=Mode.MIRROR)
    for row in range(24):
        rig.virtual["main"].servos.torque(row, True)
    rig.connect()
    rig.ticks(20)
    before = rig.counts
    assert codes(rig.call(link.Disarm)) == ["MODE_DENIES"]
    assert codes(rig.call(link.SetMode, mode="sim")) == ["MODE_DENIES"]
    assert rig.call(link.SetMode, mode="live").error is None
    rig.seconds(1.0)
    assert (rig.register("torque_enable") == 1).all()
    assert np.array_equal(rig.counts, before)
    assert codes(rig.call(link.SetMode, mode="mirror")) == ["MODE_DENIES"]
    assert rig.call(link.Disarm).parameters["state"] == "connected"
    assert (rig.register("torque_enable") == 0).all()


def test_an_unconfirmed_torque_off_is_repeated_when_the_servo_replies(make_rig: MakeRig) -> None:
    """Arming fails half-way with one joint energised and silent: it does not stay energised (X4)."""
    rig = make_rig()
    rig.connect()
    rig.lease()
    ticket = rig.send(link.Arm)
    faults = rig.virtual["main"].faults
    for _ in range(200):
        rig.ticks(1)
        if (rig.register("torque_enable") == 1).all():
            break
    faults.silence(id=11)
    for _ in range(300):
        rig.ticks(1)
        assert torque_off(rig.loop) is not True  # it is on, and silent
        assert torque_known(rig.loop)[10] != 0
    assert rig.replies(ticket)[-1].error is not None
    told = rig.events("TORQUE_MISMATCH")[-1].message
    assert told.startswith("torque could not be read back off: main: no reply")
    assert told.endswith(f"({rig.names[10]})")
    assert np.flatnonzero(rig.register("torque_enable")).tolist() == [10]
    faults.silence(id=11, on=False)
    rig.seconds(2.0)
    assert not rig.register("torque_enable").any()
    assert torque_off(rig.loop) is True
    assert torque_inherited(rig.loop) is False
