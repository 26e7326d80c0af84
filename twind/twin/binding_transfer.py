"""A bound robot as bytes, from the loop to the front it starts: both judge the very same model.

Pickled, because model and arrays are already compiled and checked. The bytes travel in a sealed memfd that
the loop made itself; nothing that a client sends ever comes here.
"""

import pickle

from twind.twin.binding import Binding
from twind.twin.dynamics import Dynamics
from twind.twin.simulation import hush
from twind.twin.trajectory_precheck import TrajectoryPrecheck


def packed(binding: Binding) -> bytes:
    """The binding as bytes."""
    return pickle.dumps(binding)


def unpacked(data: bytes) -> Binding:
    """What `packed` gave. Raises ValueError for anything else."""
    try:
        binding = pickle.loads(data)
    except Exception as error:  # noqa: BLE001  a broken handover is one error, whatever pickle calls it
        raise ValueError(f"no robot was handed over: {error!r}") from None
    if not isinstance(binding, Binding):
        raise ValueError(f"no robot was handed over: {type(binding).__name__}")
    return binding


def foresight(data: bytes, period: float) -> TrajectoryPrecheck:
    """What judges the paths of the robot handed over; `period` in s. Raises ValueError, InvalidInput."""
    hush()
    binding = unpacked(data)
    return TrajectoryPrecheck(binding, period, Dynamics(binding))
