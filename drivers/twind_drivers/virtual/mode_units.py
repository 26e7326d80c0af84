"""Operating modes (register 11) of the X series and the units of their goals."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

CURRENT = 0
VELOCITY = 1
POSITION = 3
EXTENDED = 4
CURRENT_POSITION = 5
PWM = 16
FULL_PWM = 885.0  # counts: 100 % of 0.113 %, the whole supply voltage


def seeks_position(mode: NDArray[Any]) -> NDArray[np.bool_]:
    """Return (m,) True for position goals (modes 3, 4, 5), False for current (0), velocity (1), PWM (16)."""
    return np.asarray((mode >= POSITION) & (mode <= CURRENT_POSITION))
