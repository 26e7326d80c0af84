"""`every` and `some` are numpy's `all` and `any`, for few flags and for none."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.robot.arrays import every, frozen, some


@given(st.lists(st.booleans(), max_size=30))
def test_every_and_some_equal_numpy_all_and_any(flags: list[bool]) -> None:
    array = np.array(flags, np.bool_)
    assert every(array) is bool(array.all())
    assert some(array) is bool(array.any())


def test_a_frozen_array_is_a_read_only_copy() -> None:
    source = np.array([1.0, 2.0])
    copy = frozen(source)
    source[0] = 9.0
    assert copy.tolist() == [1.0, 2.0]
    with pytest.raises(ValueError, match="read-only"):
        copy[0] = 3.0
