"""THERMAL_HEADROOM in the whole loop: hot or starved servos are not armed, first readings are awaited."""

from collections.abc import Callable

import numpy as np
import pytest

from tests.support.daemon_rig import Rig
from twind import link
from twind.loop.procedures.torque_readback import torque_on
from twind.robot.finding import ReasonCode


def codes(reply: link.Reply) -> set[str]:
    return {finding["code"] for finding in reply.parameters["findings"]}


def heat(rig: Rig) -> None:
    rig.virtual["main"].servos.protection.heat(5, 68.0)


def starve(rig: Rig) -> None:
    rig.virtual["main"].servos.supply(10.4)


@pytest.mark.parametrize(
    ("order", "code"), [(heat, ReasonCode.THERMAL_HEADROOM), (starve, ReasonCode.VOLTAGE_LOW)]
)
def test_a_hot_or_undervolted_servo_is_not_armed(
    order: Callable[[Rig], None], code: ReasonCode, live: Rig
) -> None:
    live.connect()
    order(live)
    live.seconds(0.5)
    live.call(link.AcquireLease)
    assert code in codes(live.call(link.Arm))
    assert not torque_on(live.loop)


def test_arming_at_once_waits_for_the_first_reading(live: Rig) -> None:
    while live.loop.condition.state != "connected":
        live.ticks(1)
    assert not np.isfinite(live.loop.hardware.slow.health_time).any()
    live.call(link.AcquireLease)
    assert live.call(link.Arm).error is None
    assert live.loop.torque.armed


def test_an_e_stop_ends_the_wait_of_arm_with_a_refusal(live: Rig) -> None:
    while live.loop.condition.state != "connected":
        live.ticks(1)
    live.call(link.AcquireLease)
    ticket = live.send(link.Arm)
    live.ticks(2)
    live.call(link.EStop, level="settle", reason="")
    (reply,) = live.replies(ticket)
    assert reply.error is not None and "ESTOP" in str(reply.parameters)
    assert not torque_on(live.loop)
