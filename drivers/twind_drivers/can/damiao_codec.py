"""Damiao DM actuators in MIT mode: commands, feedback, registers. Pure.

An actuator receives on its own id (register 8) and sends on another, its master id (register 7). Requests of
registers go to 7FF. Source: the vendor's register table and public drivers of it (lerobot, openarm_can,
axol); the status nibble is from public code alone and unverified. What a fault and a lost communication do to
the torque is not established: a fault of the actuator itself counts as torque off, a lost communication as
unknown.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from twind_drivers.bus import Bools, Floats, Ints
from twind_drivers.can.actuator_family import (
    ELECTRICAL,
    HEAT,
    OVERLOAD,
    SILENCE,
    UNKNOWN,
    VOLTAGE,
    ActuatorFeedback,
    FamilyRegister,
    FieldRanges,
    RegisterReply,
    RegisterType,
    ValuelessCommand,
)
from twind_drivers.can.id_lookup import NONE, Table, by_name, four, row_of, to_one
from twind_drivers.can.mit_codec import MitCodec
from twind_drivers.can.mit_frame import is_special_frame, unpack
from twind_drivers.ports.frame import BYTES, STANDARD_MASK, Frames, Octets, frames

ASK = 0x7FF  # requests of registers
READ = 0x33
WRITE = 0x55
STORE = 0xAA
REFRESH = 0xCC
LAST_REGISTER = 81
ORDERS = {
    ValuelessCommand.ENABLE: 0xFC,
    ValuelessCommand.DISABLE: 0xFD,
    ValuelessCommand.ZERO: 0xFE,
    ValuelessCommand.CLEAR: 0xFB,
}
OTHER_MODES = (0x100, 0x200, 0x300)  # position-velocity, velocity, position-force: id on top

# Status nibble -> torque on, fault bits. What no source names counts as a fault of which nothing is known.
_STATUS = {
    0x0: (0, 0),
    0x1: (1, 0),
    0x8: (0, VOLTAGE),  # over
    0x9: (0, VOLTAGE),  # under
    0xA: (0, ELECTRICAL),  # over-current
    0xB: (0, HEAT),  # power stage
    0xC: (0, HEAT),  # winding
    0xD: (-1, SILENCE),  # communication lost: its watchdog
    0xE: (0, OVERLOAD),
}
# By the whole of D0, whose low nibble is of the id.
_STATES = [_STATUS.get(octet >> 4, (-1, UNKNOWN)) for octet in range(256)]
_ENABLED, _FAULT = np.ascontiguousarray(np.array(_STATES, np.int64).T)
_NIBBLE = np.arange(256) & 0xF
# Register traffic by D1 (high byte of the id), D2 (order) and D3 (register).
_HIGH = np.arange(256) <= 0xF
_ORDER = np.isin(np.arange(256), (READ, WRITE, STORE, REFRESH))
_REGISTER = np.arange(256) <= LAST_REGISTER

TIMEOUT = FamilyRegister("timeout", 9, RegisterType.U32, writable=True, kept=True, unit=50e-6)
# Ids, serial number, CAN rate and ranges are changed by the vendor's tool: this driver only reads them.
PARAMETERS = by_name(
    FamilyRegister("under_voltage", 0, RegisterType.F32, writable=True, kept=True),
    FamilyRegister("over_temperature", 2, RegisterType.F32, writable=True, kept=True),
    FamilyRegister("over_current", 3, RegisterType.F32, writable=True, kept=True),
    FamilyRegister("acceleration", 4, RegisterType.F32, writable=True, kept=True),
    FamilyRegister("deceleration", 5, RegisterType.F32, writable=True, kept=True),
    FamilyRegister("max_speed", 6, RegisterType.F32, writable=True, kept=True),
    FamilyRegister("master_id", 7, RegisterType.U32, kept=True),
    FamilyRegister("esc_id", 8, RegisterType.U32, kept=True),
    TIMEOUT,
    FamilyRegister("mode", 10, RegisterType.U32, writable=True, kept=True),
    FamilyRegister("hardware_version", 13, RegisterType.U32, kept=True),
    FamilyRegister("firmware", 14, RegisterType.U32, kept=True),
    FamilyRegister("serial_number", 15, RegisterType.U32, kept=True),
    FamilyRegister("position_range", 21, RegisterType.F32, kept=True),
    FamilyRegister("velocity_range", 22, RegisterType.F32, kept=True),
    FamilyRegister("torque_range", 23, RegisterType.F32, kept=True),
    FamilyRegister("current_bandwidth", 24, RegisterType.F32, writable=True, kept=True),
    FamilyRegister("speed_kp", 25, RegisterType.F32, writable=True, kept=True),
    FamilyRegister("speed_ki", 26, RegisterType.F32, writable=True, kept=True),
    FamilyRegister("position_kp", 27, RegisterType.F32, writable=True, kept=True),
    FamilyRegister("position_ki", 28, RegisterType.F32, writable=True, kept=True),
    FamilyRegister("over_voltage", 29, RegisterType.F32, writable=True, kept=True),
    FamilyRegister("can_rate", 35, RegisterType.U32, kept=True),
)
IDENTITY = (
    *("position_range", "velocity_range", "torque_range", "mode", "timeout", "master_id", "esc_id"),
    *("hardware_version", "firmware", "serial_number"),
    *("under_voltage", "over_voltage", "over_temperature"),
)


class DamiaoCodec(MitCodec):
    """Codec of k Damiao actuators of one bus (`ActuatorFamily`)."""

    name = "damiao"
    product = "Damiao actuator"
    orders = ORDERS  # it has no REBOOT
    parameters: Mapping[str, FamilyRegister] = PARAMETERS
    identity: Sequence[str] = IDENTITY
    watchdog: FamilyRegister | None = TIMEOUT
    answers = 1

    def __init__(self, port: str, ids: Sequence[int], ranges: FieldRanges, masters: Sequence[int]) -> None:
        """Make the codec; `masters` (k,): id of each one's replies. Raises ValueError for ambiguous ids."""
        super().__init__(port, ids, ranges)
        self._ids = np.array(self.ids or (0,), np.int64)
        self._voice = self._voices(masters)
        for row, id in enumerate(self.ids):
            for base in OTHER_MODES:
                self._hears[base + id] = row
        receiving = {base + id for base in (0, *OTHER_MODES) for id in self.ids}
        self.claims = frozenset({*receiving, *masters, *([ASK] if self.ids else [])})
        requests = np.zeros((len(self.ids), 8), np.uint8)
        requests[:, 0] = self.ids
        requests[:, 2] = REFRESH
        self._question = frames([ASK] * len(self.ids), requests)

    def _voices(self, masters: Sequence[int]) -> tuple[Table, Table]:
        """Return the index by frame id, and the row by index + low nibble of D0, which identify a sender."""
        if len(masters) != len(self.ids):
            raise ValueError(f"{self.port}: {len(masters)} master ids for {len(self.ids)} Damiao actuators")
        places = np.zeros(STANDARD_MASK + 2, np.int64)  # the first entry belongs to no actuator
        rows = np.full(16 * (len(self.ids) + 1), NONE, np.int64)
        for row, (id, master) in enumerate(zip(self.ids, masters, strict=True)):
            if not 0 <= master < ASK or master in self.ids:
                raise ValueError(f"{self.port}: id {id}: master id {master:#x} is no id of its own below 7FF")
            places[master] = places[master] or 16 * (row + 1)
            place = places[master] + (id & 0xF)
            if rows[place] != NONE:
                raise ValueError(
                    f"{self.port}: ids {self.ids[rows[place]]} and {id} both reply on {master:#x} and appear "
                    "alike there: give each its own master id (register 7)"
                )
            rows[place] = row
        return places, rows

    def make_position_request(self) -> Frames:
        """Return frames that request one feedback frame of each (CC)."""
        return self._question

    def read(self, row: int, parameter: FamilyRegister) -> Frames:
        """Encode the read of one register (33)."""
        return to_one(ASK, self._header(row, READ, parameter) + bytes(4))

    def write(self, row: int, parameter: FamilyRegister, data: bytes) -> Frames:
        """Writes one register in RAM (55). Raises ValueError for one that is only read."""
        return to_one(ASK, self._header(row, WRITE, parameter) + four(self.port, parameter, data))

    def _header(self, row: int, order: int, parameter: FamilyRegister) -> bytes:
        return bytes([self.ids[row], 0, order, parameter.address])  # ids end at FF

    def _match_rows(self, received: Frames) -> tuple[Ints, Bools, Octets]:
        """Row that each frame may be of, whether it is of it, and the payloads (j, 8)."""
        data: Octets = received["data"]
        places, voices = self._voice
        rows = voices.take(row_of(places, received["id"]) + _NIBBLE.take(data[:, 0]))
        return rows, (rows >= 0) & (received["size"] == BYTES), data

    def feedback(self, frames: Frames) -> tuple[ActuatorFeedback, Bools]:
        """Decode frames on a master id that are no register traffic (id high byte, order, register)."""
        rows, ours, data = self._match_rows(frames)
        told = ours & ~(_HIGH.take(data[:, 1]) & _ORDER.take(data[:, 2]) & _REGISTER.take(data[:, 3]))
        if not told.all():
            rows = rows[told]
            data = data[told]
        position, velocity, effort = self.scale.values(unpack(data), rows)
        enabled = _ENABLED.take(data[:, 0])
        fault = _FAULT.take(data[:, 0])
        heat = np.maximum(data[:, 6], data[:, 7]).astype(np.float64)
        unknown = np.full(len(rows), np.nan)
        return ActuatorFeedback(rows, position, velocity, effort, enabled, fault, heat, unknown), told

    def decode_register_replies(self, frames: Frames) -> tuple[list[RegisterReply], Bools]:
        """Decode register answers on a master id: sender in full, 33 (read) or 55 (written), register."""
        rows, found, data = self._match_rows(frames)
        found &= ((data[:, 2] == READ) | (data[:, 2] == WRITE)) & _REGISTER.take(data[:, 3])
        found &= (data[:, 0] == self._ids.take(rows)) & (data[:, 1] == 0)  # ids end at FF
        answers = []
        for place in np.flatnonzero(found):
            content = data[place].tobytes()
            answers.append(RegisterReply(int(rows[place]), content[3], content[4:], content[2] == WRITE))
        return answers, found

    def learn(self, row: int, values: Mapping[str, float]) -> None:
        """Registers 21 to 23 become the ranges of this actuator. Raises ValueError for no positive number."""
        old = self.ranges
        new = FieldRanges(old.position.copy(), old.velocity.copy(), old.torque.copy(), old.kp, old.kd)
        for name, range in (
            ("position_range", new.position),
            ("velocity_range", new.velocity),
            ("torque_range", new.torque),
        ):
            if name in values:
                range[row] = values[name]
        self._take(new)

    def operating_mode(self, values: Mapping[str, float]) -> int:
        """Register 10: 1 MIT, 2 position-velocity, 3 velocity, 4 position-force; 0: it was not read."""
        return int(values.get("mode", 0))

    def commanded_rows(self, frames: Frames) -> Ints:
        """Frames on an id or on one of its other modes, and on 7FF all but read and refresh."""
        rows = row_of(self._hears, frames["id"])
        for place in np.flatnonzero(frames["id"] == ASK):
            low, high, order = (int(octet) for octet in frames["data"][place, :3])
            if order not in (READ, REFRESH) and not high and low in self.ids:
                rows[place] = self.ids.index(low)
        return rows

    def decode_commanded_position(self, frames: Frames) -> Floats:
        """Return the position of each MIT command to an id of this bus, rad.

        NaN: another or a special frame.
        """
        rows = row_of(self._hears, frames["id"])
        motion = (rows >= 0) & (frames["id"] == self._ids.take(rows)) & ~is_special_frame(frames)
        return self.scale.decode_commanded_position(frames, rows, motion)
