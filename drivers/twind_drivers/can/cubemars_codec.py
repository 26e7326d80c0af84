"""CubeMars AK actuators in MIT mode. Pure.

Source: AK manual V1.0.8, p. 48-49, which prints replies of 6 bytes and lists 8: both are taken. They have no
registers, no watchdog that a host could read back, and answer nothing but commands. The error codes and a
temperature in °C without offset are those of public drivers, unverified. Newer ("V3") firmware reportedly
uses other ids and is not driven.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from twind_drivers.bus import Bools, Floats, Ints
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
from twind_drivers.can.frame import BYTES, NOTHING, STANDARD_MASK, Frames, frames
from twind_drivers.can.id_lookup import NONE, checked_ids, row_of, to_one
from twind_drivers.can.mit_frame import BITS, FieldScale, commands, is_special_frame, unpack

SPECIAL = {ValuelessCommand.ENABLE: 0xFC, ValuelessCommand.DISABLE: 0xFD, ValuelessCommand.ZERO: 0xFE}
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


class CubeMarsCodec:
    """Codec of k AK actuators of one bus (`ActuatorFamily`)."""

    name = "cubemars"
    parameters: Mapping[str, FamilyRegister] = {}
    identity: Sequence[str] = ()
    watchdog: FamilyRegister | None = None
    answers = 0

    def __init__(self, port: str, ids: Sequence[int], ranges: FieldRanges) -> None:
        """Make the codec. Raises ValueError for ids outside 1..FF or twice the same."""
        self.port = port
        self.ids = checked_ids(port, self.name, ids, 1, 0xFF)
        self.replies: Bools = np.ones(len(self.ids), np.bool_)
        self.ranges = ranges
        self._ids = np.array(self.ids or (0,), np.int64)
        self.claims = frozenset({*self.ids, *([0] if self.ids else [])})
        self._hears = np.full(STANDARD_MASK + 2, NONE, np.int64)
        self._hears[list(self.ids)] = range(len(self.ids))
        self._scale = FieldScale(port, self.ids, ranges, BITS, BITS[:2] + BITS[4:])
        self._blank = frames(self.ids)
        self._blank["size"] = BYTES

    def make_position_request(self) -> Frames:
        """Return no frames: the drives report their position only in answer to a command."""
        return NOTHING

    def command(self, position: Floats, velocity: Floats, kp: Floats, kd: Floats, torque: Floats) -> Frames:
        """One MIT frame each. Raises WireClamp naming id, field, value and range."""
        made = self._blank.copy()
        fields = self._scale.fields(position, velocity, kp, kd, torque)
        made["data"] = commands(self._scale, fields)
        return made

    def gains(self, kp: Floats, kd: Floats) -> Frames:
        """Return no frames: every command carries them."""
        return NOTHING

    def encode_valueless_command(self, row: int, what: ValuelessCommand) -> Frames:
        """FC, FD or FE behind seven FF. Raises ValueError for REBOOT and CLEAR: no source has them."""
        if what not in SPECIAL:
            raise ValueError(f"{self.port}: id {self.ids[row]}: a CubeMars AK has no {what.name.lower()}")
        return to_one(self.ids[row], b"\xff" * 7 + bytes([SPECIAL[what]]))

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
        position, velocity, effort = self._scale.values(unpack(data), rows)
        whole = size == BYTES
        heat = np.where(whole, _CELSIUS.take(data[:, 6]), np.nan)
        fault = np.where(whole, _FAULT.take(data[:, 7]), -1)
        unsaid = np.full(len(rows), -1, np.int64)
        unknown = np.full(len(rows), np.nan)
        return ActuatorFeedback(rows, position, velocity, effort, unsaid, fault, heat, unknown), reported

    def decode_register_replies(self, frames: Frames) -> tuple[list[RegisterReply], Bools]:
        """Return no answers: there are no registers."""
        return [], np.zeros(len(frames), np.bool_)

    def learn(self, row: int, values: Mapping[str, float]) -> None:
        """Do nothing: the drive reports no ranges."""

    def operating_mode(self, values: Mapping[str, float]) -> int:
        """Return 1: the mode is unreadable; a drive in its servo mode does not answer at all."""
        return 1

    def commanded_rows(self, frames: Frames) -> Ints:
        """Return the row of each frame on an id of this bus; a reply on the drive's own id counts, too."""
        return row_of(self._hears, frames["id"])

    def decode_commanded_position(self, frames: Frames) -> Floats:
        """Return the position of each MIT command to an id of this bus, rad.

        NaN: another or a special frame.
        """
        rows = self.commanded_rows(frames)
        motion = (rows >= 0) & ~is_special_frame(frames)
        return self._scale.decode_commanded_position(frames, rows, motion)
