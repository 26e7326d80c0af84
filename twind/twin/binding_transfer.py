"""Transfer of a bound robot from the loop to the front: both judge the same model.

Pickled, because model and arrays are already compiled and checked. The bytes travel in a sealed memfd from
the loop itself; data from clients never reach this module.
"""

import pickle

from twind.twin.binding import Binding
from twind.twin.dynamics import Dynamics
from twind.twin.simulation import hush
from twind.twin.trajectory_precheck import TrajectoryPrecheck


def packed(binding: Binding) -> bytes:
    """Return the binding as bytes."""
    return pickle.dumps(binding)


def unpacked(data: bytes) -> Binding:
    """Return the binding from the bytes of `packed`. Raises ValueError for anything else."""
    try:
        binding = pickle.loads(data)
    except Exception as error:  # noqa: BLE001  a broken handover is one error, whatever pickle raises
        raise ValueError(f"no robot was handed over: {error!r}") from None
    if not isinstance(binding, Binding):
        raise ValueError(f"no robot was handed over: {type(binding).__name__}")
    return binding


def foresight(data: bytes, period: float) -> TrajectoryPrecheck:
    """Return the precheck for the robot in `data`; `period` in s. Raises ValueError, InvalidInput."""
    hush()
    binding = unpacked(data)
    return TrajectoryPrecheck(binding, period, Dynamics(binding))
