"""Addresses of the rare path for all that a family can do, and the bytes of a register's value. Pure.

An address below `SPECIALS` is a register of the actuator's family. Above it are the orders that are no
registers: five orders without a value, one whole command, gains, and the state from feedback.
"""

import math
import struct
from collections.abc import Mapping, Sequence
from difflib import get_close_matches

import numpy as np

from twind_drivers.bus import (
    Bools,
    Floats,
    GroupWriteBatch,
    Order,
    PingRequest,
    Query,
    ReadRequest,
    RebootRequest,
    Script,
    WriteRequest,
)
from twind_drivers.can.actuator_family import FamilyRegister, RegisterType, ValuelessCommand
from twind_drivers.can.actuator_group import ActuatorGroup, joined
from twind_drivers.can.can_transaction import CanTransaction
from twind_drivers.device_registers import unknown_register
from twind_drivers.ports.frame import NOTHING, Frames

SPECIALS = 0x1_0000  # addresses of the orders without a value begin here ...
ADDRESS = {
    special: SPECIALS + number for number, special in enumerate(ValuelessCommand)
}  # ... and there are five
SPECIAL = {address: special for special, address in ADDRESS.items()}
COMMAND = SPECIALS + 0x10  # written: position, velocity, kp, kd, torque, as five little-endian doubles
GAINS = SPECIALS + 0x11  # written: kp and kd, as two; nothing where commands carry them
STATE = SPECIALS + 0x12  # read: three bytes, torque (0, 1, 255 unknown), fault bits, 1 if these were reported
MILLI = 1e3  # whole numbers stand for thousandths of a float's unit


def decode(parameter: FamilyRegister, data: bytes) -> float:
    """Return a register's value from its four bytes. NaN and infinity are kept."""
    [value] = struct.unpack_from(parameter.kind.value, data.ljust(4, b"\0"))
    return float(value)


def encode(parameter: FamilyRegister, value: float) -> bytes:
    """Return the four bytes of a value. Raises ValueError naming the register if it cannot hold the value."""
    if not math.isfinite(value) or (parameter.kind is not RegisterType.F32 and value != int(value)):
        raise ValueError(f"{parameter.name}: {value} is no value of it: a finite {parameter.kind.name} is")
    try:
        raw = struct.pack(parameter.kind.value, value if parameter.kind is RegisterType.F32 else int(value))
    except (struct.error, OverflowError):
        raise ValueError(f"{parameter.name}: {value} does not fit into {parameter.kind.name}") from None
    return raw.ljust(4, b"\0")


def parameter_of(fleet: ActuatorGroup, row: int, name: str) -> FamilyRegister:
    """A register by its name, in any spelling, or by its address. Raises InvalidInput."""
    family, _ = fleet.family_of_row(row)
    key = name.strip().lower().replace(" ", "_").replace("-", "_")
    found = family.parameters.get(key)
    if found is None and key[:1].isdigit():
        found = by_address(family.parameters, int(key, 0))
    if found is None:
        near = get_close_matches(key, family.parameters, 3, 0.4) or list(family.parameters)[:3]
        raise unknown_register(family.name, name, near)
    return found


def by_address(parameters: Mapping[str, FamilyRegister], address: int) -> FamilyRegister | None:
    """Return the register at an address; None: there is none."""
    return next((each for each in parameters.values() if each.address == address), None)


def read_register(
    ids: Sequence[int], parameter: FamilyRegister, count: int, tries: int
) -> Script[tuple[dict[int, bytes], float]]:
    """Read one register of actuators of a family, `count` at once, with up to `tries` requests to each.

    Returns the values by id, without those of silent actuators, and the time waited, s.
    """
    found: dict[int, bytes] = {}
    waited = 0.0
    for _ in range(tries):
        missing = [id for id in ids if id not in found]
        for first in range(0, len(missing), count):
            reply = yield ReadRequest(tuple(missing[first : first + count]), parameter.address, 4)
            found.update(reply.data)
            waited += reply.waited
    return found, waited


def state(enabled: int, fault: int) -> bytes:
    """Encode the result of a read of `STATE`."""
    return bytes((enabled & 0xFF, max(fault, 0), fault >= 0))


def encode_register_value(parameter: FamilyRegister, value: float) -> int:
    """Return a value as a whole number, a float in thousandths. Raises ValueError for NaN, infinity."""
    if not math.isfinite(value):
        raise ValueError(f"{parameter.name} reads {value}")
    return round(value * MILLI) if parameter.kind is RegisterType.F32 else int(value)


def part(parameter: FamilyRegister, value: int) -> float:
    """Return the value of a register from such a whole number."""
    return value / MILLI if parameter.kind is RegisterType.F32 else value


# --------------------------------------------------------------------------------------------- to frames


def asks_state(query: Query) -> bool:
    """Return whether a request is for the state alone, which feedback answers."""
    return isinstance(query, PingRequest) or query.address == STATE


def rows_of(fleet: ActuatorGroup, query: Query) -> Bools:
    """Return the actuators (m,) that a query addresses; ids that are not on this bus are ignored."""
    ids = (query.id,) if isinstance(query, PingRequest) else query.ids
    rows = np.zeros(len(fleet), np.bool_)
    rows[[fleet.ids.index(id) for id in ids if id in fleet.ids]] = True
    return rows


def asking(fleet: ActuatorGroup, query: ReadRequest) -> CanTransaction:
    """Return the frames that request a register, and the expected answers; none for devices without it."""
    requests: list[Frames] = []
    wanted: set[tuple[int, int]] = set()
    for row in np.flatnonzero(rows_of(fleet, query)).tolist():
        family, _ = fleet.family_of_row(row)
        found = by_address(family.parameters, query.address)
        if found is None:
            continue
        try:
            requests.append(fleet.read(row, found))
        except ValueError:  # the script that reads it has refused it before
            continue
        wanted.add((row, query.address))
    return CanTransaction(joined(requests), np.zeros(len(fleet), np.int64), registers=frozenset(wanted))


def ordering(fleet: ActuatorGroup, order: Order) -> CanTransaction:
    """Return the frames of an order. Raises ValueError for an unsupported one, KeyError for an unknown id."""
    writes = (
        (order,)
        if isinstance(order, WriteRequest)
        else order.writes
        if isinstance(order, GroupWriteBatch)
        else ()
    )
    made = [_encode_write(fleet, each) for each in writes]
    if isinstance(order, RebootRequest):
        made = [fleet.encode_valueless_command(fleet.row(order.id), ValuelessCommand.REBOOT)]
    frames = joined(made)
    to = fleet.commanded_rows(frames)
    count = np.bincount(to[to >= 0], minlength=len(fleet))
    plain = all(each.address < SPECIALS for each in writes) and not isinstance(order, RebootRequest)
    acks = (count > 0) & fleet.replies
    nothing = np.zeros(len(fleet), np.int64)
    if plain:
        return CanTransaction(frames, nothing, acks=acks)
    return CanTransaction(
        frames, np.where(fleet.replies, count, 0) if not isinstance(order, RebootRequest) else nothing
    )


def _encode_write(fleet: ActuatorGroup, write: WriteRequest) -> Frames:
    rows = {fleet.row(id): data for id, data in write.data.items()}
    chosen = np.zeros(len(fleet), np.bool_)
    chosen[list(rows)] = True
    if write.address == COMMAND:
        return fleet.command(_values(fleet, rows, 5), chosen) if rows else NOTHING
    if write.address == GAINS:
        kp, kd = _values(fleet, rows, 2)
        return fleet.gains(kp, kd, chosen) if rows else NOTHING
    if write.address in SPECIAL:
        return joined([fleet.encode_valueless_command(row, SPECIAL[write.address]) for row in rows])
    made = []
    for row, data in rows.items():
        family, _ = fleet.family_of_row(row)
        found = by_address(family.parameters, write.address)
        if found is None:
            raise ValueError(f"{fleet.name}: id {fleet.ids[row]} has no register {write.address:#x}")
        made.append(fleet.write(row, found, data))
    return joined(made)


def _values(fleet: ActuatorGroup, rows: Mapping[int, bytes], count: int) -> Floats:
    values = np.zeros((count, len(fleet)))
    for row, data in rows.items():
        values[:, row] = struct.unpack(f"<{count}d", data)
    return values


def whole_command(values: Floats) -> bytes:
    """Encode one actuator's position, velocity, kp, kd and torque for `COMMAND`."""
    return struct.pack(f"<{len(values)}d", *(float(value) for value in values))
