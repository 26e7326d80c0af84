"""The matrix of faults, a few injections of each row; `make faults` makes as many as are asked for."""

import pytest

from tests.proof.faults.matrix import MATRIX
from tests.proof.faults.quiet import quiet
from tests.proof.faults.world import once

QUICK = (10, 26)  # a servo's and a client's; all others where time allows
WALK = [number for number in sorted(MATRIX) if MATRIX[number].virtual is not None]


def test_every_row_of_the_matrix_has_a_form_or_a_reason_for_its_absence() -> None:
    assert sorted(MATRIX) == list(range(1, 43))
    for number, row in MATRIX.items():
        assert row.number == number
        assert row.virtual is not None or row.real is not None
        assert (row.virtual is not None and row.real is not None) or row.instead, row.name


@pytest.mark.parametrize("number", QUICK)
def test_a_quick_fault_is_reported_in_time_and_handled_correctly(number: int) -> None:
    found = once(MATRIX[number], 0)
    assert not found.wrong, "\n".join(found.wrong)


@pytest.mark.slow
@pytest.mark.parametrize("number", WALK)
def test_every_fault_is_reported_in_time_and_handled_correctly(number: int) -> None:
    found = once(MATRIX[number], 1)
    assert not found.wrong, "\n".join([f"make faults ROW={number} SEED=1", *found.wrong])


def test_seven_seconds_without_a_fault_are_without_an_alarm() -> None:
    found = quiet(0.002)
    assert not found["wrong"], found


@pytest.mark.campaign
def test_three_minutes_without_a_fault_are_without_an_alarm() -> None:
    """`make faults HOURS=1` makes it an hour."""
    found = quiet(0.05, 1)
    assert not found["wrong"], found
    assert found["motions"] > 10
