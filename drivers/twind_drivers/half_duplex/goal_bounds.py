"""Bounds of the goals of a bus, checked. Pure."""

import numpy as np

from twind_drivers.bus import Ints


def bounds_of(name: str, count: int, lower: Ints, upper: Ints) -> tuple[Ints, Ints]:
    """Return copies (m,) of the bounds. Raises ValueError if not `count` of each, or lower above upper."""
    least = np.array(lower, np.int64)
    most = np.array(upper, np.int64)
    if least.shape != (count,) or most.shape != (count,):
        raise ValueError(f"{name}: bounds of {count} devices needed, got {least.shape}")
    if not (least <= most).all():
        raise ValueError(f"{name}: lower bounds {lower} must not be above upper bounds {upper}")
    return least, most
