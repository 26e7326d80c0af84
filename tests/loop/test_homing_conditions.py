"""Registers of servos that end an end-stop search."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from twind.loop.procedures.homing_conditions import servo_findings
from twind.robot.finding import ReasonCode

WATCHDOG = 5.0
SINCE = 2.0  # s, when torque came on


def found(powered: float | None = SINCE, joint: int = 1, **changed: float) -> list[Any]:
    """Findings of a search of joint 1 of three; `changed`: registers of `joint`."""
    slow = SimpleNamespace(
        torque=np.array([0, 1, 0], np.int8),
        watchdog=np.array([0, 5, 0], np.int16),
        fault=np.array([-1, 0, 0], np.int16),
        status_time=np.array([1.0, SINCE + 0.1, 1.0]),
    )
    for name, value in changed.items():
        getattr(slow, name)[joint] = value
    pending: Any = SimpleNamespace(request=SimpleNamespace(joint=1), powered=powered, watchdog=WATCHDOG)
    context: Any = SimpleNamespace(hardware=SimpleNamespace(slow=slow))
    return [
        (each.code, each.joint, each.value, each.bound, each.message)
        for each in servo_findings(context, pending)
    ]


def test_a_servo_that_holds_with_its_watchdog_ends_nothing() -> None:
    assert found() == []
    assert found(fault=-1) == [], "an error that was not read"


@pytest.mark.parametrize("joint", [0, 2])
@pytest.mark.parametrize("powered", [None, SINCE])
def test_torque_of_another_joint_ends_it_at_any_time(joint: int, powered: float | None) -> None:
    expected = (ReasonCode.TORQUE_MISMATCH, joint, 1.0, 0.0, "its torque is on")
    assert found(powered, joint, torque=1) == [expected]
    assert found(powered, joint, torque=-1) == []


@pytest.mark.parametrize("torque", [0, -1])
def test_torque_that_went_off_ends_it(torque: int) -> None:
    expected = (ReasonCode.TORQUE_MISMATCH, 1, float(torque), 1.0, "torque went off")
    assert found(torque=torque) == [expected]


@pytest.mark.parametrize(("watchdog", "code"), [(255, "WATCHDOG_TRIPPED"), (4, "DEVICE_MISMATCH")])
def test_a_watchdog_that_tripped_or_differs_ends_it(watchdog: int, code: str) -> None:
    [(seen, joint, value, bound, message)] = found(watchdog=watchdog)
    assert (seen, joint, value) == (ReasonCode(code), 1, float(watchdog))
    assert bound == (WATCHDOG if code == "DEVICE_MISMATCH" else None)
    assert "watchdog" in message


def test_a_hardware_error_ends_it() -> None:
    assert found(fault=1) == [(ReasonCode.SERVO_ALERT, 1, 1.0, 0.0, "hardware error")]


@pytest.mark.parametrize("powered", [None, SINCE + 0.1])
def test_registers_that_were_not_read_since_torque_came_on_say_nothing(powered: float | None) -> None:
    assert found(powered, torque=0, watchdog=255, fault=1) == []
