"""Buses of serial servos without a watchdog, one of each family, for what their writers have in common."""

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import pytest

from tests.support.dynamixel1_rig import QUICK, Dynamixel1Rig
from tests.support.feetech_rig import FeetechRig
from tests.support.unwatched_rig import UnwatchedRig
from twind_drivers.dynamixel1.virtual_dynamixel1_spec import Dynamixel1ServoSpec
from twind_drivers.feetech.virtual_feetech_spec import FeetechServoSpec


def feetech(count: int = 2) -> FeetechRig:
    return FeetechRig([FeetechServoSpec(id) for id in range(1, count + 1)])


def mx(count: int = 2) -> Dynamixel1Rig:
    return Dynamixel1Rig([Dynamixel1ServoSpec(id, "MX-28(1.0)", QUICK) for id in range(1, count + 1)])


def xl(count: int = 2) -> UnwatchedRig:
    return UnwatchedRig(["XL-320"] * count, {})


MAKERS = pytest.mark.parametrize("make", [feetech, mx, xl])


def contents(rig: Any, name: str) -> list[int]:
    """Return the content of that register of each servo."""
    return [rig.servos.get(row, name) for row in range(rig.m)]


def ignores_writes(rig: Any, row: int, *, of: str | None = None) -> None:
    """Make the servo of that row confirm writes and keep its values; `of`: of that register."""
    write = rig.servos.write
    address = None if of is None else rig.reader.table(row + 1)[of].address
    rig.servos.write = lambda one, at, data: (
        0 if one == row and address in (None, at) else write(one, at, data)
    )


def run(rig: Any, script: Any, meet: Callable[[Any], None]) -> None:
    """Run a script; `meet` is called with each order before it is sent."""
    order = next(script)
    with suppress(StopIteration):
        while True:
            meet(order)
            order = script.send(rig.transact(order))
