"""Histories of delayed controls and sensors, as an episode begins: as if it had always been so.

MuJoCo's reset fills them with zeros, and a delayed servo would be sent to 0 for the length of its delay.
"""

from typing import Any

import numpy as np

from twind.robot.arrays import Floats, Ints

_HEADER = 2  # of a buffer: what its user keeps, and the cursor; then the times, then the samples


class DelayHistories:
    """Where `mjData.history` of a model has the samples of its controls and sensors."""

    def __init__(self, model: Any) -> None:
        kept = zip(model.actuator_historyadr, model.actuator_history[:, 0], strict=True)
        self._controls = [
            (control, _slots(at, samples, 1)) for control, (at, samples) in enumerate(kept) if samples
        ]
        told = zip(
            model.sensor_historyadr,
            model.sensor_history[:, 0],
            model.sensor_adr,
            model.sensor_dim,
            strict=True,
        )
        self._sensors = [
            (slice(first, first + size), _slots(at, samples, size))
            for at, samples, first, size in told
            if samples
        ]

    def fill_controls(self, history: Floats, control: Floats) -> None:
        """The controls were `control` (nu,) all along; `history` (nhistory,) is changed."""
        for each, slots in self._controls:
            history[slots] = control[each]

    def fill_sensors(self, history: Floats, told: Floats) -> None:
        """The sensors have told `told` (nsensordata,) all along: what a forward pass without delay tells."""
        for of, slots in self._sensors:
            history[slots] = told[of]


def _slots(address: int, samples: int, size: int) -> Ints:
    """(samples, size): the places in `history` of a buffer that begins at `address`."""
    first = address + _HEADER + samples
    return np.arange(first, first + samples * size, dtype=np.int64).reshape(samples, size)
