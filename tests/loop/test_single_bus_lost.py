"""One of two buses is lost while armed: fault matrix rows 1 and 2, by support. Real bytes, a fake clock."""

import numpy as np
import pytest

from tests.support.daemon_rig import MakeRig, Rig
from twind import link
from twind.loop.procedures.internal_faults import inhibit
from twind.loop.procedures.torque_readback import torque_inherited
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import RobotState

pytestmark = pytest.mark.slow  # whole lives of the loop: half of all fast tests' time


def one_bus_lost(make_rig: MakeRig, support: str | None = None) -> Rig:
    """A robot whose upper bus went away while its knee moved, ten seconds ago."""
    rig = make_rig("h24-split", support=support)
    rig.arm()
    rig.submit(rig.path("l_knee", [0.6], [1.0]))
    rig.seconds(0.5)
    rig.virtual["upper"].faults.unplug()
    rig.seconds(10.0)
    assert rig.loop.condition.state is RobotState.FAULT
    assert "PORT_LOST" in rig.loop.condition.latches
    return rig


@pytest.mark.parametrize("support", ["free", "unknown"])
def test_the_loss_of_a_bus_lowers_the_other_joints_of_an_unsupported_robot(
    make_rig: MakeRig, support: str
) -> None:
    rig = one_bus_lost(make_rig, support)
    assert rig.loop.torque.armed is False
    assert not any(rig.virtual["lower"].servos["torque_enable"])
    assert all(rig.virtual["upper"].servos["torque_enable"])  # nothing reached them
    rig.virtual["upper"].faults.replug()
    rig.seconds(3.0)
    assert rig.loop.condition.state is RobotState.FAULT
    assert torque_inherited(rig.loop) is False
    assert (rig.register("torque_enable") == 0).all()
    rig.call(link.Reset)
    rig.lease()
    assert rig.call(link.Arm).error is None


@pytest.mark.parametrize("support", ["fixed", "gantry"])
def test_the_loss_of_a_bus_leaves_a_supported_robot_holding_until_disarm(
    make_rig: MakeRig, support: str
) -> None:
    rig = one_bus_lost(make_rig, support)
    knee = rig.names.index("l_knee")
    upper = rig.virtual["upper"]
    lower = rig.virtual["lower"]
    assert 0.1 < rig.truth[knee] < 0.5  # where it came to rest on its way
    held = np.asarray(lower.servos["goal_position"]).copy()
    rig.seconds(12.0)
    assert rig.loop.torque.armed is True
    assert np.array_equal(rig.loop.torque.held, rig.loop.robot.joints.on_bus("lower"))
    assert all(lower.servos["torque_enable"])
    assert (np.asarray(lower.servos["bus_watchdog"]) == 5).all()
    assert np.array_equal(lower.servos["goal_position"], held)
    goals = np.asarray(upper.servos["goal_position"]).copy()
    upper.faults.replug()
    rig.seconds(3.0)
    assert rig.loop.hardware.connected
    assert rig.loop.condition.state is RobotState.FAULT
    assert np.array_equal(upper.servos["goal_position"], goals)
    assert np.array_equal(lower.servos["goal_position"], held)
    rig.call(link.Disarm, ticks=700)
    assert (rig.register("torque_enable") == 0).all()
    assert np.abs(rig.truth - rig.loop.robot.rest).max() < 0.05  # all of it was lowered, the returned bus too
    rig.call(link.Reset)
    rig.lease()
    assert rig.call(link.Arm).error is None


def test_a_bus_that_is_back_and_was_moved_by_hand_does_not_damp_those_that_hold(make_rig: MakeRig) -> None:
    rig = one_bus_lost(make_rig, "gantry")
    upper = rig.virtual["upper"]
    lower = rig.virtual["lower"]
    for row in range(len(upper.servos.registers.ids())):
        upper.servos.torque(row, False)
    upper.servos.muscles.position[:] += 700.0
    upper.faults.replug()
    rig.seconds(3.0)
    assert rig.loop.hardware.connected
    assert rig.loop.torque.soft_since is None
    assert "FOLLOW_ERR" not in rig.loop.condition.latches
    assert all(lower.servos["torque_enable"])


def test_the_loss_of_the_last_holding_bus_disarms_though_another_has_returned(make_rig: MakeRig) -> None:
    rig = one_bus_lost(make_rig, "gantry")
    rig.virtual["upper"].faults.replug()
    rig.seconds(2.0)
    upper = rig.virtual["upper"].servos
    goals = np.asarray(upper["goal_position"]).copy()
    rig.virtual["lower"].faults.unplug()
    rig.seconds(8.0)
    assert rig.loop.torque.armed is False
    assert torque_inherited(rig.loop) is True
    assert rig.loop.condition.state is RobotState.FAULT
    assert all(upper["torque_enable"])
    assert np.array_equal(upper["goal_position"], goals)


def test_a_bus_lost_by_an_inhibited_robot_does_not_drop_the_other(make_rig: MakeRig) -> None:
    rig = make_rig("h24-split")
    rig.arm()
    inhibit(rig.loop, Finding(ReasonCode.INTERNAL), rig.clock.now())
    rig.seconds(0.5)
    rig.virtual["upper"].faults.unplug()
    rig.seconds(2.0)
    assert "PORT_LOST" in rig.loop.condition.latches
    assert rig.loop.condition.state is RobotState.INHIBITED
    assert all(rig.virtual["lower"].servos["torque_enable"])


@pytest.mark.parametrize("how", ["estop", "shutdown"])
def test_a_robot_holding_after_a_bus_loss_is_lowered_by_e_stop_or_sigterm(
    make_rig: MakeRig, how: str
) -> None:
    rig = one_bus_lost(make_rig, "gantry")
    if how == "estop":
        rig.send(link.EStop)
        rig.seconds(5.0)
    else:
        rig.loop.condition.stop_wanted = True
        rig.seconds(6.5)
        assert rig.loop.condition.finished
    assert not any(rig.virtual["lower"].servos["torque_enable"])
    assert abs(rig.truth[rig.names.index("l_knee")]) < 0.05


@pytest.mark.parametrize("again", ["lost", "mute"])
def test_a_bus_lost_again_during_takeover_does_not_delay_the_other(make_rig: MakeRig, again: str) -> None:
    rig = one_bus_lost(make_rig, "gantry")
    upper = rig.virtual["upper"]
    upper.faults.replug()
    rig.seconds(2.0)
    rig.send(link.Disarm)
    rig.ticks(3)
    if again == "lost":
        upper.faults.unplug()
    else:
        for id in upper.servos["id"]:
            upper.faults.silence(int(id))
    torque = rig.virtual["lower"].servos
    knee = rig.names.index("l_knee")
    for _ in range(900):
        rig.ticks(1)
        if not any(torque["torque_enable"]):
            break
    assert not any(torque["torque_enable"])
    assert abs(rig.truth[knee]) < 0.05, "the other bus was dropped"
