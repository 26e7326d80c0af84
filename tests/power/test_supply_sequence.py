"""Order of the relay over time, and the judgement of its effect."""

import pytest

from twind.power.power_states import RelayState
from twind.power.supply_sequence import SupplyFault, SupplyInput, SupplySequence

FALL = 1.0  # s
COMES, MORE = 5.0, 0.5  # s: as docs/safety.md states them
TICK = 0.01


class Run:
    """A sequence in steps of a tick."""

    def __init__(self) -> None:
        self.sequence = SupplySequence(FALL)
        self.now = 10.0

    def steps(
        self,
        seconds: float,
        relay: RelayState = RelayState.OPEN,
        *,
        idle: bool = True,
        stop: bool = False,
        powered: bool | None = False,
    ) -> None:
        for _ in range(round(seconds / TICK)):
            self.sequence.step(self.now, SupplyInput(relay, idle, stop, powered))
            self.now += TICK


@pytest.fixture
def run() -> Run:
    return Run()


def test_it_closes_only_after_the_supply_had_time_to_fall(run: Run) -> None:
    run.steps(FALL + MORE - 0.05)
    assert not run.sequence.wanted
    run.steps(0.1)
    assert run.sequence.wanted


@pytest.mark.parametrize("powered", [False, None])
def test_a_closed_relay_without_a_fault_stays_wanted(run: Run, powered: bool | None) -> None:
    run.steps(2.0)
    run.steps(COMES - 0.1, RelayState.CLOSED, powered=powered)
    assert run.sequence.wanted
    assert run.sequence.fault is None


def test_a_supply_that_stays_behind_the_open_relay_is_a_fault_and_keeps_it_open(run: Run) -> None:
    run.steps(FALL - 0.05, powered=True)
    assert run.sequence.fault is None
    run.steps(5.0, powered=True)
    assert run.sequence.fault is SupplyFault.STAYS
    assert not run.sequence.wanted
    run.steps(0.1, powered=False)
    assert run.sequence.fault is None
    assert run.sequence.wanted


def test_a_supply_that_does_not_come_is_a_fault_until_it_comes(run: Run) -> None:
    run.steps(2.0)
    run.steps(COMES + 0.1, RelayState.CLOSED)
    assert run.sequence.fault is SupplyFault.MISSING
    assert run.sequence.wanted
    run.steps(0.1, RelayState.CLOSED, powered=True)
    assert run.sequence.fault is None
    run.steps(2 * COMES, RelayState.CLOSED)  # lost later: VOLTAGE and STATE_STALE report that
    assert run.sequence.fault is None


def test_it_does_not_close_under_torque_and_does_not_open_for_it(run: Run) -> None:
    run.steps(5.0, idle=False)
    assert not run.sequence.wanted
    run.steps(0.1)
    assert run.sequence.wanted
    run.steps(5.0, RelayState.CLOSED, idle=False, powered=True)
    assert run.sequence.wanted


def test_a_stop_opens_it_and_its_end_closes_it_only_after_the_fall(run: Run) -> None:
    run.steps(2.0)
    run.steps(1.0, RelayState.CLOSED, powered=True)
    run.steps(0.02, RelayState.CLOSED, stop=True, powered=True)
    assert not run.sequence.wanted
    run.steps(0.1, stop=True)
    run.steps(FALL)
    assert not run.sequence.wanted
    run.steps(MORE)
    assert run.sequence.wanted


@pytest.mark.parametrize(
    ("relay", "fault"),
    [
        (RelayState.UNKNOWN, SupplyFault.ABSENT),
        (RelayState.TRIPPED, SupplyFault.TRIPPED),
        (RelayState.FAILED, SupplyFault.FAILED),
    ],
)
def test_after_a_failure_it_is_open_for_a_while_before_it_closes(
    run: Run, relay: RelayState, fault: SupplyFault
) -> None:
    run.steps(2.0)
    run.steps(1.0, RelayState.CLOSED, powered=True)
    run.steps(0.5, relay)
    assert run.sequence.fault is fault
    assert not run.sequence.wanted
    run.steps(FALL)
    assert not run.sequence.wanted
    run.steps(MORE + 0.05)
    assert run.sequence.wanted


def at(sequence: SupplySequence, now: float, relay: RelayState, powered: bool | None = False) -> bool:
    """Return whether the relay is wanted after a step at `now`, s."""
    sequence.step(now, SupplyInput(relay, True, False, powered))
    return sequence.wanted


def test_the_bounds_of_time_belong_to_what_they_allow() -> None:
    sequence = SupplySequence(FALL)
    assert sequence.fault is SupplyFault.ABSENT and not sequence.wanted
    assert not at(sequence, -9.0, RelayState.UNKNOWN)
    assert not at(sequence, 0.0, RelayState.OPEN)
    at(sequence, FALL - 0.001, RelayState.OPEN, powered=True)
    assert sequence.fault is None
    at(sequence, FALL, RelayState.OPEN, powered=True)
    assert sequence.fault is SupplyFault.STAYS
    assert not at(sequence, FALL + MORE - 0.001, RelayState.OPEN)
    assert at(sequence, FALL + MORE, RelayState.OPEN)
    assert at(sequence, 16.0, RelayState.CLOSED)
    assert at(sequence, 16.0 + COMES - 0.001, RelayState.CLOSED) and sequence.fault is None
    assert at(sequence, 16.0 + COMES, RelayState.CLOSED)
    assert sequence.fault is SupplyFault.MISSING


def test_a_relay_that_opened_of_itself_is_closed_after_a_fall_alone() -> None:
    sequence = SupplySequence(FALL)
    at(sequence, 0.0, RelayState.OPEN)
    assert at(sequence, FALL + MORE, RelayState.OPEN)
    assert at(sequence, 2.0, RelayState.CLOSED, powered=True)
    assert not at(sequence, 3.0, RelayState.OPEN)
    assert at(sequence, 3.0 + FALL + MORE, RelayState.OPEN)


def test_a_supply_from_before_the_relay_closed_does_not_count() -> None:
    sequence = SupplySequence(FALL)
    at(sequence, 0.0, RelayState.CLOSED, powered=True)
    at(sequence, 1.0, RelayState.OPEN)
    at(sequence, 2.0, RelayState.CLOSED)
    at(sequence, 2.0 + COMES, RelayState.CLOSED)
    assert sequence.fault is SupplyFault.MISSING
