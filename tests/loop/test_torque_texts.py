"""Refusals and the status are never more certain about torque than the readings of the loop."""

import pytest

from tests.support.daemon_rig import MakeRig, Rig
from twind import link
from twind.loop.procedures.internal_faults import inhibit
from twind.robot.finding import Finding, ReasonCode
from twind.robot.recovery_steps import UNKNOWN

LOWER = "`twindctl disarm`, then find and mend the cause, then `twindctl reset`, then `twindctl arm`"


@pytest.fixture
def armed(make_rig: MakeRig) -> Rig:
    rig = make_rig()
    rig.arm()
    return rig


def refusal(rig: Rig) -> str:
    """Return the text of the latched fault that refuses arming."""
    rig.lease()
    reply = rig.call(link.Arm)
    assert reply.error == "Refused"
    (text,) = [
        found["message"]
        for found in reply.parameters["findings"]
        if found["code"] == ReasonCode.FAULT_LATCHED
    ]
    return str(text)


def overview_torque(rig: Rig) -> bool | None:
    """Return whether torque is on by the newest overview."""
    rig.seconds(0.2)
    rig.collect_news()
    return [each for each in rig.news if isinstance(each, link.Overview)][-1].torque_on


def test_torque_of_an_unplugged_robot_is_not_known_until_it_is_read_again(armed: Rig) -> None:
    assert overview_torque(armed) is True
    for bus in armed.virtual.values():
        bus.faults.unplug()
    armed.seconds(2.0)
    assert all(bus.servos["torque_enable"].all() for bus in armed.virtual.values())
    assert overview_torque(armed) is None
    assert refusal(armed) == f"PORT_LOST; {UNKNOWN}; next: {LOWER}"
    for bus in armed.virtual.values():
        bus.faults.replug()
    armed.seconds(4.0)
    assert overview_torque(armed) is True
    assert refusal(armed) == f"PORT_LOST; torque is on; next: {LOWER}"
    assert armed.call(link.Disarm, ticks=1500).error is None
    assert overview_torque(armed) is False
    assert "; torque is off; " in refusal(armed)


def test_torque_that_is_being_switched_counts_as_on(armed: Rig) -> None:
    armed.loop.torque.begin_release()
    assert not armed.loop.torque.armed
    armed.loop.hardware.slow.torque[:] = 0
    armed.loop.reports.urgent = True
    armed.loop.publisher.publish(armed.clock.now())
    armed.collect_news()
    assert [each for each in armed.news if isinstance(each, link.Overview)][-1].torque_on is True


def test_an_inhibited_robot_is_to_be_supported_before_disarm_drops_it(armed: Rig) -> None:
    inhibit(armed.loop, Finding(ReasonCode.INTERNAL), armed.clock.now())
    armed.seconds(1.0)
    assert refusal(armed) == (
        f"INTERNAL, WATCHDOG_TRIPPED; torque is on; next: support the robot, then {LOWER}"
    )
