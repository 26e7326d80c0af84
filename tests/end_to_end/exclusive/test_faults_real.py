"""A row of each kind over pseudo-terminals, with real processes; `make faults REAL=3` runs all."""

import pytest

from tests.proof.faults.ground import once_real
from tests.proof.faults.matrix import MATRIX


@pytest.mark.parametrize("number", [10, 26])
def test_a_fault_is_reported_and_handled_in_real_time(number: int) -> None:
    found = once_real(MATRIX[number], 0)
    assert not found.wrong, "\n".join(found.wrong)


@pytest.mark.slow
@pytest.mark.parametrize("number", [8, 18])
def test_more_faults_are_reported_and_handled_in_real_time(number: int) -> None:
    found = once_real(MATRIX[number], 1)
    assert not found.wrong, "\n".join(found.wrong)
