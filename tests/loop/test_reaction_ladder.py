"""The ladder of reactions when one meets another: INHIBIT on the way down, what a damping leaves behind."""

import numpy as np
import pytest

from tests.support.daemon_rig import Rig
from tests.support.reaction_rig import PWM, P, injected_findings, raised, soft
from twind import link
from twind.loop.procedures.internal_faults import inhibit
from twind.loop.procedures.torque_readback import torque_off
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import RobotState
from twind.safety.guard_types import Reaction
from twind_drivers.dynamixel.damping import SHARE
from twind_drivers.half_duplex.soft_gain import SOFT

pytestmark = pytest.mark.slow  # whole lives of the loop: half of all fast tests' time

BUG = Finding(ReasonCode.INTERNAL, message="ordered by the test")


def torques(rig: Rig) -> np.ndarray:
    return rig.register("torque_enable") == 1


@pytest.mark.parametrize("begin", ["disarm", "settle", "damp", "estop", "shutdown"])
def test_an_inhibit_on_the_way_down_writes_nothing_more_and_torque_stays(armed: Rig, begin: str) -> None:
    """It must not drop what was being lowered: nothing is written, the servos stop by themselves."""
    raised(armed)
    ticket = 0
    if begin == "disarm":
        ticket = armed.send(link.Disarm)
    elif begin == "estop":
        ticket = armed.send(link.EStop, more=True)
    elif begin == "shutdown":
        armed.loop.condition.stop_wanted = True
    else:
        with injected_findings(
            armed, reaction=Reaction.SETTLE if begin == "settle" else Reaction.DAMP, latches=True
        ):
            armed.ticks(1)
    armed.ticks(40)
    assert torques(armed).all()
    goals = armed.register("goal_position")
    gains = armed.register("position_p_gain")
    inhibit(armed.loop, BUG, armed.clock.now())
    if begin == "shutdown":
        armed.ticks(3)
        assert armed.loop.condition.finished
    else:
        armed.seconds(8.0)
        assert armed.loop.condition.state is RobotState.INHIBITED
    assert torques(armed).all()
    assert np.array_equal(armed.register("goal_position"), goals)
    assert np.array_equal(armed.register("position_p_gain"), gains)
    if ticket:
        assert armed.replies(ticket), "who asked is told how it ended"
    if begin != "shutdown":
        assert armed.call(link.Disarm, ticks=200).error is None
        assert not torques(armed).any()


def test_an_inhibit_does_not_keep_torque_that_is_going_off(armed: Rig) -> None:
    armed.send(link.EStop, level="cut")
    armed.ticks(1)
    inhibit(armed.loop, BUG, armed.clock.now())
    armed.seconds(1.5)
    assert not torques(armed).any()
    assert torque_off(armed.loop)


@pytest.mark.parametrize("reaction", [Reaction.HOLD, Reaction.SETTLE, Reaction.DAMP])
def test_nothing_softer_ends_an_inhibit(armed: Rig, reaction: Reaction) -> None:
    raised(armed)
    inhibit(armed.loop, BUG, armed.clock.now())
    armed.ticks(5)
    goals = armed.register("goal_position")
    with injected_findings(armed, reaction=reaction, latches=True, here=(3,)):
        armed.seconds(2.0)
    assert torques(armed).all()
    assert np.array_equal(armed.register("goal_position"), goals)
    assert (armed.register("position_p_gain") == P).all()
    assert armed.loop.torque.soft_since is None


def test_a_damping_whose_buses_are_lost_does_not_make_the_next_way_down_a_drop(armed: Rig) -> None:
    """Power gone while damped, so torque is off when it is back: armed anew, a fault must lower again."""
    with injected_findings(armed, reaction=Reaction.DAMP, latches=True):
        armed.ticks(5)
    bus = armed.virtual["main"]
    bus.faults.unplug()
    armed.ticks(5)
    for row in range(24):
        bus.servos.torque(row, False)
    armed.seconds(7.0)
    bus.faults.replug()
    armed.seconds(2.0)
    assert armed.loop.torque.soft_since is None
    armed.call(link.Reset)
    armed.lease()
    assert armed.call(link.Arm).error is None
    raised(armed)
    with injected_findings(armed, reaction=Reaction.SETTLE, latches=True):
        armed.ticks(2)
    armed.seconds(0.6)
    assert torques(armed).all(), "let go at once, with the arm raised"
    armed.seconds(6.0)
    assert not torques(armed).any()
    assert not armed.events("DAMP")[1:]


def test_a_damped_robot_whose_watchdogs_trip_does_not_stiffen_again(armed: Rig) -> None:
    """An e-stop takes the damping over after the loop stood still: no gains come back on the way to off."""
    raised(armed)
    with injected_findings(armed, reaction=Reaction.DAMP, latches=True):
        armed.ticks(1)
    armed.ticks(20)
    assert soft(armed)
    armed.clock.sleep_until(armed.clock.now() + 0.2)  # nobody ticks
    armed.ticks(40)
    assert (armed.loop.hardware.slow.watchdog == 255).any()
    armed.send(link.EStop)
    for _ in range(700):
        armed.ticks(1)
        if not torques(armed).all():
            break
        assert soft(armed)
    assert not torques(armed).any()


@pytest.mark.parametrize("after", range(1, 16, 2))
def test_an_interrupted_disarm_preparation_does_not_stiffen_a_damped_robot(armed: Rig, after: int) -> None:
    """Tripped watchdogs, a disarm that clears them, and DAMP in the middle of that."""
    raised(armed)
    armed.clock.sleep_until(armed.clock.now() + 0.2)  # nobody ticks
    armed.ticks(40)
    assert (armed.loop.hardware.slow.watchdog == 255).any()
    armed.send(link.Disarm)
    armed.ticks(after)
    with injected_findings(armed, reaction=Reaction.DAMP, latches=True):
        armed.ticks(1)
    armed.ticks(25)
    for _ in range(200):
        if not torques(armed).all():
            break
        assert (armed.register("position_p_gain") == P // SOFT).all()
        capped = armed.register("goal_pwm") == int(SHARE * PWM)
        assert (capped | armed.virtual["main"].servos.tripped).all()  # who has tripped takes no cap
        armed.ticks(1)
    assert not torques(armed).any()
