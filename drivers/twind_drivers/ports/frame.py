"""CAN frame as a numpy record, and batches of them as one array. Pure.

The layout is that of `struct can_frame` (linux/can.h): the form in a kernel socket and at every channel here.
Up to 8 bytes: no CAN FD.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

EXTENDED = 0x8000_0000  # 29-bit id
REMOTE = 0x4000_0000  # requests data, and has none
ERROR = 0x2000_0000  # of the controller, not of the wire: never data
STANDARD_MASK = 0x7FF
EXTENDED_MASK = 0x1FFF_FFFF
BYTES = 8  # payload at most

FRAME = np.dtype([("id", "<u4"), ("size", "u1"), ("pad", "V3"), ("data", "u1", (BYTES,))])
Frames = NDArray[np.void]  # (k,) of FRAME; `id` with the three flags above, `data` zero beyond `size`
Octets = NDArray[np.uint8]

NOTHING: Frames = np.zeros(0, FRAME)
NOTHING.setflags(write=False)


def frames(ids: Sequence[int] | NDArray[Any], data: Octets | None = None) -> Frames:
    """One frame for each id (k,), flags included. `data` (k, 8), or (8,) for all; None: no payload."""
    made = np.zeros(len(ids), FRAME)
    made["id"] = ids
    if data is not None:
        made["data"] = data
        made["size"] = BYTES
    return made


def payload(frame: Any) -> bytes:
    """The bytes of one frame."""
    return bytes(frame["data"][: int(frame["size"])].tobytes())
