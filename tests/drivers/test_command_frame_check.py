"""The last check of command frames by their bytes: actuators of this bus, positions inside their bounds."""

import numpy as np
import pytest

from tests.support.can_driver_rig import RANGES, CanRig
from twind_drivers.bus import WireRangeError
from twind_drivers.can.actuator_family import ValuelessCommand
from twind_drivers.can.actuator_group import ActuatorGroup, joined
from twind_drivers.can.can_units import COUNT
from twind_drivers.can.command_frame_check import CommandFrameCheck
from twind_drivers.ports.frame import Frames

LOWER, UPPER = -500, 700


def group(*models: str) -> ActuatorGroup:
    return CanRig(models).reader.fleet


def check_of(fleet: ActuatorGroup, lower: int = LOWER, upper: int = UPPER) -> CommandFrameCheck:
    return CommandFrameCheck(fleet, np.full(len(fleet), lower), np.full(len(fleet), upper))


def commands(fleet: ActuatorGroup, *ticks: float) -> Frames:
    values = np.zeros((5, len(fleet)))
    values[0] = np.array(ticks) * COUNT
    values[3] = 1.0
    return fleet.command(values)


def test_commands_within_bounds_and_orders_without_a_position_pass() -> None:
    fleet = group("DM4310", "ODrive", "RS01")
    orders = [fleet.encode_valueless_command(row, ValuelessCommand.ENABLE) for row in range(3)]
    check_of(fleet).judge(joined([*orders, commands(fleet, LOWER, 0, UPPER)]))


def test_the_first_frame_that_is_out_of_bounds_is_named_with_its_place_and_its_bounds() -> None:
    fleet = group(*["ODrive"] * 3)
    with pytest.raises(WireRangeError, match=r"arm: id 2: goal 8\d\d\.") as refused:
        check_of(fleet).judge(commands(fleet, 0, 800, LOWER - 100))
    found = refused.value
    assert found.value == pytest.approx(800.0, abs=0.01)
    assert (found.id, found.lower, found.upper) == (2, LOWER, UPPER)
    with pytest.raises(WireRangeError) as refused:
        check_of(fleet).judge(commands(fleet, 0, 0, LOWER - 100))
    assert refused.value.id == 3


@pytest.mark.parametrize("place", [0, 1, 2])
def test_a_frame_to_an_unknown_id_is_refused_wherever_it_stands(place: int) -> None:
    fleet = group(*["DM4310"] * 3)
    frames = commands(fleet, 0, 0, 0)
    frames["id"][place:] += 100
    with pytest.raises(WireRangeError, match="order to a frame id") as refused:
        check_of(fleet).judge(frames)
    found = refused.value
    assert (found.id, found.value, found.lower, found.upper) == (101 + place, 101 + place, 1, 3)


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize(
    ("reach", "step"),
    [(6.0, 1.0), (12.5, 1.0), (100.0, 200.0 / 0xFFFF / COUNT)],
)
def test_one_count_beyond_a_bound_passes_or_one_step_of_a_coarser_field_and_no_more(
    monkeypatch: pytest.MonkeyPatch, side: int, reach: float, step: float
) -> None:
    monkeypatch.setitem(RANGES, "ODrive", (reach, 30.0, 10.0))
    fleet = group("ODrive", "ODrive")  # its position is a float: nothing is truncated
    check = check_of(fleet, 0, 0)
    check.judge(commands(fleet, side * step * (1.0 - 2e-6 * (step != 1.0)), 0))
    with pytest.raises(WireRangeError):
        check.judge(commands(fleet, side * step * (1.0 + 2e-6), 0))


def test_a_range_that_an_actuator_reports_later_widens_its_step() -> None:
    fleet = group("DM4310", "DM4310")
    check = check_of(fleet, -1000, -1000)
    check.judge(commands(fleet, -1000, -1000))
    fleet.learn(1, {"position_range": 100.0})  # a step of 8 counts, to which a goal is truncated
    frames = commands(fleet, -1000, -1000)
    assert fleet.decode_commanded_position(frames)[1] / COUNT < -1001.5
    check.judge(frames)
    with pytest.raises(WireRangeError) as refused:
        check.judge(commands(fleet, -1000, -1009))
    assert refused.value.id == 2
    with pytest.raises(WireRangeError) as refused:
        check.judge(commands(fleet, -1003, -1000))
    assert refused.value.id == 1, "its own step is what it was"
