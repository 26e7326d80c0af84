"""SIGTERM, and torque that was ordered off before: nothing is driven after a cut, and no bus is forgotten."""

from typing import Any

import numpy as np
import pytest

from tests.support.daemon_rig import MakeRig, Rig
from twind import link
from twind.robot.modes import RobotState

pytestmark = pytest.mark.slow  # whole lives of the loop: half of all fast tests' time

YAW = 0.4  # rad, where the head is when it is stopped
AWAITED = 1.5 + 0.1  # s that a lost bus is waited for, with the ticks around it


def energised(rig: Rig) -> Any:
    """Joints (n,) whose servo has torque on."""
    return rig.register("torque_enable") == 1


def turned(rig: Rig, joint: str = "head_yaw", place: float = YAW) -> Rig:
    """An armed robot with one joint away from the rest pose."""
    rig.arm()
    rig.submit(rig.path(joint, [place], [1.0]))
    rig.seconds(1.5)
    return rig


def keep_torque(rig: Rig, row: int) -> None:
    """The servo in that row of the only bus replies, and does not take torque off."""
    servos = rig.virtual["main"].servos
    real = servos.torque

    def torque(which: int, on: bool, *more: Any) -> Any:
        return real(which, on or which == row, *more)

    servos.torque = torque


def end(rig: Rig, most: float = 20.0) -> float:
    """SIGTERM, if it was not sent yet, and the ticks to the end of the daemon; s that took."""
    rig.loop.condition.stop_wanted = True
    begun = rig.clock.now()
    while not rig.loop.condition.finished:
        rig.ticks(1)
        assert rig.clock.now() - begun < most, "the daemon does not end"
    return float(rig.clock.now() - begun)


# --------------------------------------------------------------------------------------------- after a cut


@pytest.mark.parametrize("moment", [1, 5, 150])
def test_a_servo_that_keeps_its_torque_after_a_cut_is_not_driven_by_sigterm(
    make_rig: MakeRig, moment: int
) -> None:
    rig = turned(make_rig())
    keep_torque(rig, 0)
    rig.send(link.EStop, level="cut")
    rig.ticks(moment)
    before = rig.truth[0]
    goal = np.asarray(rig.virtual["main"].servos["goal_position"]).copy()
    took = end(rig)
    assert before == pytest.approx(YAW, abs=0.05)
    assert rig.truth[0] == pytest.approx(before, abs=0.01)
    assert np.array_equal(rig.virtual["main"].servos["goal_position"], goal)
    assert took < 2 * AWAITED + 1.0
    assert any("head_yaw may be on" in event.message for event in rig.events("TORQUE_MISMATCH"))


@pytest.mark.parametrize("order", ["disarm", "settle", "bus lost"])
def test_after_a_cut_nothing_is_driven_by_another_order(make_rig: MakeRig, order: str) -> None:
    rig = turned(make_rig())
    keep_torque(rig, 0)
    rig.send(link.EStop, level="cut")
    rig.seconds(1.5)
    before = rig.truth[0]
    if order == "disarm":
        rig.send(link.Disarm)
    elif order == "settle":
        rig.send(link.EStop, level="settle")
    else:
        rig.virtual["main"].faults.unplug()
        rig.ticks(5)
        rig.virtual["main"].faults.replug()
    rig.seconds(5.0)
    assert rig.truth[0] == pytest.approx(before, abs=0.01)
    assert energised(rig).sum() == 1


def test_a_cut_that_a_lost_bus_missed_runs_when_it_returns_to_an_ending_daemon(make_rig: MakeRig) -> None:
    rig = turned(make_rig())
    rig.virtual["main"].faults.unplug()
    rig.ticks(5)
    rig.call(link.EStop, level="cut")
    rig.loop.condition.stop_wanted = True
    rig.ticks(20)
    before = rig.truth[0]
    rig.virtual["main"].faults.replug()
    end(rig)
    assert not energised(rig).any()
    assert rig.truth[0] == pytest.approx(before, abs=0.01)
    assert not rig.events("TORQUE_MISMATCH")[1:], "once reported, and confirmed"


def test_a_stop_that_settles_is_run_by_an_ending_daemon_for_torque_that_was_found(make_rig: MakeRig) -> None:
    rig = make_rig(start={"head_yaw": YAW})
    bus = rig.virtual["main"]
    for row in range(24):
        bus.servos.torque(row, True)
    bus.faults.unplug()
    rig.ticks(20)
    rig.send(link.EStop, level="settle")
    rig.ticks(5)
    rig.loop.condition.stop_wanted = True
    rig.ticks(20)
    bus.faults.replug()
    end(rig)
    assert not energised(rig).any()
    assert abs(rig.truth[0]) < 0.05, "lowered"


# --------------------------------------------------------------------------------------------- lost buses


def lowering(make_rig: MakeRig) -> Rig:
    """A robot on two buses that is being lowered for SIGTERM."""
    rig = turned(make_rig("h24-split"), "l_knee", 0.6)
    rig.loop.condition.stop_wanted = True
    rig.ticks(50)
    return rig


@pytest.mark.parametrize("back", [True, False])
def test_a_bus_that_is_lost_on_the_way_down_is_waited_for_after_it(make_rig: MakeRig, back: bool) -> None:
    rig = lowering(make_rig)
    rig.virtual["upper"].faults.unplug()
    while any(rig.virtual["lower"].servos["torque_enable"]):
        rig.ticks(1)
    rig.seconds(0.5)
    assert not rig.loop.condition.finished
    if back:
        rig.virtual["upper"].faults.replug()
    took = 0.5 + end(rig)
    assert any(rig.virtual["upper"].servos["torque_enable"]) is not back
    if back:
        assert rig.loop.condition.state is RobotState.FAULT
    else:
        assert took == pytest.approx(1.5, abs=0.2)
        assert "may be on" in rig.events("TORQUE_MISMATCH")[-1].message


@pytest.mark.parametrize("moment", [5, 50, 90])
def test_with_every_bus_lost_the_daemon_waits_and_says_what_may_be_on(make_rig: MakeRig, moment: int) -> None:
    rig = turned(make_rig("h24-split"), "l_knee", 0.6)
    rig.loop.condition.stop_wanted = True
    rig.ticks(moment)
    rig.virtual["lower"].faults.unplug()
    rig.virtual["upper"].faults.unplug()
    assert 1.4 < end(rig) < 2 * AWAITED
    assert energised(rig).all()
    assert "21 more may be on" in rig.events("TORQUE_MISMATCH")[-1].message


def test_a_bus_that_returns_after_the_release_is_switched_off_while_the_other_is_away(
    make_rig: MakeRig,
) -> None:
    rig = lowering(make_rig)
    rig.virtual["upper"].faults.unplug()
    while any(rig.virtual["lower"].servos["torque_enable"]):
        rig.ticks(1)
    rig.ticks(10)
    rig.virtual["lower"].faults.unplug()
    rig.ticks(5)
    rig.virtual["upper"].faults.replug()
    end(rig)
    assert not energised(rig).any()


@pytest.mark.parametrize("first", ["lower", "upper"])
def test_a_bus_that_returns_to_an_ending_daemon_is_switched_off_while_another_is_away(
    make_rig: MakeRig, first: str
) -> None:
    rig = turned(make_rig("h24-split"), "l_knee", 0.6)
    rig.virtual["lower"].faults.unplug()
    rig.virtual["upper"].faults.unplug()
    rig.ticks(5)
    rig.loop.condition.stop_wanted = True
    rig.ticks(20)
    rig.virtual[first].faults.replug()
    end(rig)
    other = {"lower": "upper", "upper": "lower"}[first]
    assert not any(rig.virtual[first].servos["torque_enable"])
    assert all(rig.virtual[other].servos["torque_enable"])


def test_a_bus_that_is_lost_while_a_disarm_begins_is_switched_off_when_it_returns(make_rig: MakeRig) -> None:
    for moment in range(1, 8):
        rig = make_rig("h24-split")
        for bus in rig.virtual.values():
            for row in range(len(np.asarray(bus.servos["id"]))):
                bus.servos.torque(row, True)
        rig.connect()
        rig.send(link.Disarm)
        rig.ticks(moment)
        rig.virtual["upper"].faults.unplug()
        rig.seconds(8.0)
        assert not any(rig.virtual["lower"].servos["torque_enable"]), moment
        rig.virtual["upper"].faults.replug()
        rig.seconds(3.0)
        assert not any(rig.virtual["upper"].servos["torque_enable"]), moment
