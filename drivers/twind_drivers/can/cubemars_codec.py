"""CubeMars AK actuators in MIT mode. Pure.

Source: AK manual V1.0.8, p. 48-49, which prints replies of 6 bytes and lists 8: both are taken. They have no
registers, no watchdog that a host could read back, and answer nothing but commands. The error codes and a
temperature in °C without offset are those of public drivers, unverified. Newer ("V3") firmware reportedly
uses other ids and is not driven.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from twind_drivers.bus import Bools, Ints
from twind_drivers.can.actuator_family import (
    ELECTRICAL,
    ENCODER,
    HEAT,
    OVERLOAD,
    UNKNOWN,
    VOLTAGE,
    ActuatorFeedback,
    FamilyRegister,
    FieldRanges,
    RegisterReply,
    ValuelessCommand,
)
from twind_drivers.can.id_lookup import row_of
from twind_drivers.can.mit_codec import MitCodec
from twind_drivers.can.mit_frame import unpack
from twind_drivers.ports.frame import BYTES, NOTHING, Frames

ORDERS = {ValuelessCommand.ENABLE: 0xFC, ValuelessCommand.DISABLE: 0xFD, ValuelessCommand.ZERO: 0xFE}
SHORT = 6  # bytes of a reply without temperature and error
HOTTEST = 215  # of the temperature byte, °C; above it counts from -40, so that cold is not taken for heat

_FAULTS = {
    0: 0,
    1: HEAT,  # motor
    2: ELECTRICAL,  # over-current
    3: VOLTAGE,  # over
    4: VOLTAGE,  # under
    5: ENCODER,
    6: HEAT,  # power stage
    7: OVERLOAD,  # locked
}
_FAULT = np.array([_FAULTS.get(code, UNKNOWN) for code in range(256)], np.int64)
_CELSIUS = np.array([float(octet if octet <= HOTTEST else octet - 256) for octet in range(256)])


class CubeMarsCodec(MitCodec):
    """Codec of k AK actuators of one bus (`ActuatorFamily`)."""

    name = "cubemars"
    product = "CubeMars AK"
    orders = ORDERS  # no source has REBOOT and CLEAR
    parameters: Mapping[str, FamilyRegister] = {}
    identity: Sequence[str] = ()
    watchdog: FamilyRegister | None = None
    answers = 0

    def __init__(self, port: str, ids: Sequence[int], ranges: FieldRanges) -> None:
        """Make the codec. Raises ValueError for ids outside 1..FF or twice the same."""
        super().__init__(port, ids, ranges)
        self.claims = frozenset({*self.ids, *([0] if self.ids else [])})

    def make_position_request(self) -> Frames:
        """Return no frames: the drives report their position only in answer to a command."""
        return NOTHING

    def read(self, row: int, parameter: FamilyRegister) -> Frames:
        """Raise ValueError: the family has no registers."""
        raise ValueError(f"{self.port}: id {self.ids[row]}: a CubeMars AK in MIT mode has no registers")

    def write(self, row: int, parameter: FamilyRegister, data: bytes) -> Frames:
        """Raise ValueError: the family has no registers."""
        raise ValueError(f"{self.port}: id {self.ids[row]}: a CubeMars AK in MIT mode has no registers")

    def feedback(self, frames: Frames) -> tuple[ActuatorFeedback, Bools]:
        """Decode frames of 6 or 8 bytes on id 0 or on the drive's own id, whose D0 is that id.

        Firmwares differ in the id. A reply on its own id has the id of a command: no echo of sent frames may
        come here. The feedback does not include the torque state.
        """
        data = frames["data"]
        size = frames["size"]
        came = frames["id"]
        rows = self._hears.take(data[:, 0])
        reported = (rows >= 0) & ((size == BYTES) | (size == SHORT)) & ((came == 0) | (came == data[:, 0]))
        if not reported.all():
            rows = rows[reported]
            data = data[reported]
            size = size[reported]
        position, velocity, effort = self.scale.values(unpack(data), rows)
        whole = size == BYTES
        heat = np.where(whole, _CELSIUS.take(data[:, 6]), np.nan)
        fault = np.where(whole, _FAULT.take(data[:, 7]), -1)
        unsaid = np.full(len(rows), -1, np.int64)
        unknown = np.full(len(rows), np.nan)
        return ActuatorFeedback(rows, position, velocity, effort, unsaid, fault, heat, unknown), reported

    def decode_register_replies(self, frames: Frames) -> tuple[list[RegisterReply], Bools]:
        """Return no answers: there are no registers."""
        return [], np.zeros(len(frames), np.bool_)

    def operating_mode(self, values: Mapping[str, float]) -> int:
        """Return 1: the mode is unreadable."""
        return 1

    def commanded_rows(self, frames: Frames) -> Ints:
        """Return the row of each frame on an id of this bus; a reply on the drive's own id counts, too."""
        return row_of(self._hears, frames["id"])
