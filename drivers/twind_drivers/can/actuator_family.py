"""Interface of an actuator family to the bus: its frames, both ways. Pure: no I/O, no clock.

A family object represents the k actuators of one bus that are of this family, in the order of `ids`. Arrays
are (k,) and SI: rad, rad/s, N·m at the output, N·m/rad, N·m·s/rad, °C, V. Encoders **raise** `WireRangeError`
for a value outside its field; they never clamp. A decoder takes untrusted frames: it ignores frames of other
devices, and nothing raises.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum, auto
from typing import NamedTuple, Protocol

from twind_drivers.bus import Bools, Floats, Ints
from twind_drivers.ports.frame import NOTHING, Frames

# The contract's bits of a hardware error, as those of a serial servo's register 70 where they mean the same.
VOLTAGE, UNCALIBRATED, HEAT, ENCODER, ELECTRICAL, OVERLOAD, SILENCE, UNKNOWN = (1 << bit for bit in range(8))


class ValuelessCommand(Enum):
    """Orders without a value."""

    ENABLE = auto()  # torque on
    DISABLE = auto()  # torque off
    CLEAR = auto()  # forget the fault
    ZERO = auto()  # the present position is zero from now on
    REBOOT = auto()  # restart; ValueError where the family has none


class RegisterType(Enum):
    """Encoding of a register's four bytes, little-endian."""

    U8 = "<B"
    U16 = "<H"
    I16 = "<h"
    U32 = "<I"
    F32 = "<f"


class FamilyRegister(NamedTuple):
    """Register of a family."""

    name: str  # snake case
    address: int
    kind: RegisterType
    writable: bool = False
    kept: bool = False  # survives power-off once it was stored
    unit: float = 1.0  # SI per raw unit, for what has one (watchdog: s per tick)


@dataclass(slots=True)
class FieldRanges:
    """Field ranges of each actuator, symmetric about 0. (k,). Read from the device where it reports them."""

    position: Floats  # rad
    velocity: Floats  # rad/s
    torque: Floats  # N·m
    kp: Floats  # N·m/rad, from 0
    kd: Floats  # N·m·s/rad, from 0


@dataclass(frozen=True, slots=True)
class ActuatorFeedback:
    """Feedback in a batch of frames, of the actuators in it. Arrays (j,), in order of arrival."""

    rows: Ints  # row of the k; of several entries of one row the last is the newest
    position: Floats  # rad; NaN: not in this frame
    velocity: Floats
    effort: Floats
    enabled: Ints  # 1 torque on, 0 off, -1 not in this frame
    fault: Ints  # bits above; 0: none; -1: not in this frame
    temperature: Floats  # °C, the hottest reported; NaN unknown
    voltage: Floats  # V; NaN unknown


class RegisterReply(NamedTuple):
    """Value of a register, or the acknowledgement of a write."""

    row: int
    address: int
    data: bytes  # 4, little-endian; of an acknowledgement what was written, or empty
    written: bool = False  # an acknowledgement, which does not prove the register's value


class ActuatorFamily(Protocol):
    """Family of actuators on one bus. The codecs inherit what is the same for most families."""

    name: str
    ids: tuple[int, ...]
    ranges: FieldRanges
    parameters: Mapping[str, FamilyRegister]
    # Registers that identification reads of each; the names are those of `parameters`.
    identity: Sequence[str]
    watchdog: FamilyRegister | None  # None: it has none that can be read back over this bus
    # Frames that one actuator sends in reply to a position request. 0: it reports only in reply to a command
    # (CubeMars in MIT mode) or by itself.
    answers: int
    claims: frozenset[int]  # 11-bit ids that it receives or sends; no other device of that bus may have them
    replies: Bools  # (k,) True: it answers every command with feedback

    def make_position_request(self) -> Frames:
        """Return frames that request the position of all; moves nothing, changes no torque. May be empty."""

    def command(self, position: Floats, velocity: Floats, kp: Floats, kd: Floats, torque: Floats) -> Frames:
        """Encode one command each.

        Raises WireRangeError naming id, field, value and range; then nothing is made.
        """

    def gains(self, kp: Floats, kd: Floats) -> Frames:
        """Return the frames needed before torque where `command` carries no stiffness and damping (k,).

        They set these, and the mode that the commands need. Empty, the default, where `command` carries all.
        Raises WireRangeError.
        """
        return NOTHING

    def encode_valueless_command(self, row: int, what: ValuelessCommand) -> Frames:
        """Return the frame of one order. Raises ValueError where the family has no such order."""

    def read(self, row: int, parameter: FamilyRegister) -> Frames:
        """Encode the read of one register. Raises ValueError where the family cannot (see each family)."""

    def write(self, row: int, parameter: FamilyRegister, data: bytes) -> Frames:
        """Encode the write of one register in RAM, `data` of 4 bytes. Raises ValueError where it cannot."""

    def feedback(self, frames: Frames) -> tuple[ActuatorFeedback, Bools]:
        """Decode all feedback among `frames`; also return which frames were feedback (len(frames),)."""

    def decode_register_replies(self, frames: Frames) -> tuple[list[RegisterReply], Bools]:
        """Decode all register answers among `frames`; also return which frames those were."""

    def learn(self, row: int, values: Mapping[str, float]) -> None:
        """Take the identification values of one actuator: ranges from the device replace the configured ones.

        Raises ValueError for a range that is no positive number; then nothing is changed. A family that
        reports no ranges does nothing: those of the configuration must be confirmed by moving.
        """
        return

    def operating_mode(self, values: Mapping[str, float]) -> int:
        """Derive the mode from the identification values: 1 where the device takes this family's commands.

        Any other mode gives the value that the device reports, and never 1, whatever its number (see each
        family). 0: it was not read. A family whose mode is unreadable gives 1.
        """

    def commanded_rows(self, frames: Frames) -> Ints:
        """Return the row that each frame commands, enables or writes; -1: none. For the last check."""

    def decode_commanded_position(self, frames: Frames) -> Floats:
        """Return the position (len(frames),) rad that each frame commands; NaN: none, or not to these ids."""
