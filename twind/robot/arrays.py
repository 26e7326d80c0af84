"""Names for the arrays that the whole house passes around."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


def frozen(array: Floats | list[float]) -> Floats:
    """A float64 copy that nobody can write to."""
    copy = np.array(array, np.float64)
    copy.setflags(write=False)
    return copy
