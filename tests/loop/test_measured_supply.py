"""Findings of supply control: faults of the relay, and what devices report behind it."""

from math import nan
from typing import Any

import pytest

from tests.support.supply_rig import EPSILON, FALL, LOW, Supply
from twind.power.power_states import RelayState
from twind.power.supply_sequence import COMES, MORE
from twind.robot.finding import ReasonCode
from twind.robot.modes import Mode

FRESH, LOOK, LEAST = 0.5, 0.1, 3.0  # s, s, V


@pytest.fixture
def rig() -> Supply:
    return Supply()


def test_a_fault_of_the_relay_is_reported_once_and_bars_arming_until_it_is_gone(rig: Supply) -> None:
    rig.child.relay = RelayState.FAILED
    rig.child.trouble = "relay lcus1 at relay: no such device"
    rig.reports.urgent = False
    for _ in range(2):
        rig.serve(0.01)
    assert rig.reports.urgent
    text = "the relay cannot be used: relay lcus1 at relay: no such device"
    [event] = rig.book.events
    assert (event.level, event.code, event.message) == ("error", "SUPPLY_RELAY", text)
    [found] = event.findings
    assert (found.code, found.message, found.value, found.bound) == (
        ReasonCode.SUPPLY_RELAY,
        text,
        None,
        None,
    )
    assert rig.control.findings == [found]
    rig.child.trouble = ""
    assert rig.faults() == ["the relay cannot be used"]
    rig.reports.urgent = False
    rig.child.relay = RelayState.OPEN
    rig.serve(0.01)
    assert rig.reports.urgent and rig.faults() == [] and len(rig.book.events) == 1


def test_at_the_start_an_absent_process_bars_arming_and_is_no_event(rig: Supply) -> None:
    rig.child.relay = RelayState.UNKNOWN
    rig.child.trouble = "not of this fault"
    rig.serve()
    assert rig.faults() == ["the process of the relay does not run"] and rig.book.events == []
    rig.child.relay = RelayState.TRIPPED
    rig.serve()
    assert rig.faults() == ["the relay opened: the loop did not complete a tick in time"]
    rig.condition.mode = Mode.SIM
    assert rig.control.findings == []


def test_in_sim_a_fault_is_no_event(rig: Supply) -> None:
    rig.condition.mode = Mode.SIM
    rig.child.relay = RelayState.FAILED
    rig.serve()
    assert rig.book.events == [] and rig.control.findings == []


def stays(rig: Supply, *volts: float, age: float = 0.0) -> bool:
    """Check for a fault of a relay that has been open for long, while devices report these voltages."""
    rig.serve()
    rig.serve(FALL + LOOK)
    rig.supply(*volts, age=age)
    rig.serve(LOOK + EPSILON)
    return bool(rig.faults())


@pytest.mark.parametrize(
    ("volts", "age", "found"),
    [
        ((LOW, nan, nan), 0.0, True),
        ((LOW - 0.01, nan, nan), 0.0, False),
        ((nan, nan, LEAST), 0.0, True),  # a joint without a bound of its own
        ((nan, nan, LEAST - 0.01), 0.0, False),
        ((LOW - 0.01, 12.0, LEAST - 0.01), 0.0, True),
        ((nan, nan, nan), 0.0, False),
        ((12.0, 12.0, 12.0), FRESH - LOOK - 2 * EPSILON, True),
        ((12.0, 12.0, 12.0), FRESH - LOOK, False),
    ],
)
def test_a_supply_behind_an_open_relay_is_one_fresh_voltage_above_its_bound(
    rig: Supply, volts: tuple[float, ...], age: float, found: bool
) -> None:
    assert stays(rig, *volts, age=age) is found


def test_a_supply_that_was_measured_just_half_a_second_ago_counts(rig: Supply) -> None:
    rig.clock.time = 0.0
    rig.serve()
    rig.supply(12.0, 12.0, 12.0, age=-(FALL + LOOK))
    rig.clock.time = FALL + LOOK + FRESH
    rig.serve()
    assert rig.faults()


def test_one_joint_with_a_fresh_reading_is_enough(rig: Supply) -> None:
    rig.serve()
    rig.serve(FALL + LOOK)
    rig.supply(12.0, 12.0, 12.0)
    rig.hardware.slow.health_time[1:] -= FRESH
    rig.serve(LOOK + EPSILON)
    assert rig.faults()


def test_only_joints_with_a_fresh_reading_count(rig: Supply) -> None:
    rig.serve()
    rig.serve(FALL + LOOK)
    rig.supply(12.0, LOW - 0.01, nan)
    rig.hardware.slow.health_time[0] -= FRESH
    rig.serve(LOOK + EPSILON)
    assert rig.faults() == []


def test_a_supply_that_stays_is_reported_with_the_highest_voltage_and_the_lowest_bound(rig: Supply) -> None:
    assert stays(rig, 11.0, 12.5, nan)
    [found] = rig.control.findings
    assert (found.value, found.bound) == (12.5, LEAST)
    assert found.message.startswith("V, the supply stays while the relay is open")
    rig.supply(nan, nan, nan)  # it goes, and is looked at later
    assert rig.control.findings[0].value == 0.0


def test_the_supply_is_measured_ten_times_a_second(rig: Supply) -> None:
    rig.clock.time = -FALL
    rig.serve()
    rig.clock.time = 0.0
    rig.serve()
    rig.supply(12.0, 12.0, 12.0)
    rig.clock.time = LOOK - EPSILON
    rig.serve()
    assert rig.faults() == []
    rig.clock.time = LOOK
    rig.serve()
    assert rig.faults()


def missing(rig: Supply, passed: float) -> Any:
    """The findings `passed` s after the relay has closed, with no supply since."""
    rig.serve()
    rig.serve(FALL + MORE)
    rig.child.relay = RelayState.CLOSED
    rig.serve(LOOK)
    rig.serve(passed)
    return rig.control.findings


def test_a_supply_that_does_not_come_is_reported_with_the_time_that_it_has(rig: Supply) -> None:
    assert missing(rig, COMES - EPSILON) == []
    rig.serve(2 * EPSILON)
    [found] = rig.control.findings
    assert (found.value, found.bound) == (COMES, COMES)
    assert found.message.startswith("s since the relay closed")


def test_voltages_below_their_bound_are_no_supply_and_unknown_ones_are_not_judged(rig: Supply) -> None:
    low = Supply()
    low.supply(1.0, 1.0, 1.0, age=-20.0)
    assert len(missing(low, COMES)) == 1
    unknown = Supply()
    unknown.supply(nan, nan, nan, age=-20.0)
    assert missing(unknown, COMES) == []


def test_without_an_open_bus_the_supply_is_not_judged(rig: Supply) -> None:
    rig.hardware.away[:] = True
    assert missing(rig, COMES) == []
    part = Supply()
    part.hardware.away[:] = (True, True, False)
    assert len(missing(part, COMES)) == 1
