"""Clients, faults and deaths in random order, under a fake clock: `make model N=100` has more of it."""

import pytest
from hypothesis import HealthCheck, settings
from hypothesis.stateful import run_state_machine_as_test

from tests.proof.model.machine import Daemon

SHORT = settings(
    max_examples=2,
    stateful_step_count=12,
    deadline=None,
    derandomize=True,
    suppress_health_check=list(HealthCheck),
)


@pytest.mark.slow
def test_every_invariant_holds_in_random_command_and_fault_sequences() -> None:
    run_state_machine_as_test(Daemon, settings=SHORT)
