"""Identification of the expected devices of a bus, as a script that only reads."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import floor
from typing import Protocol

from twind_drivers.bus import IdentifiedDevice, PingRequest, Query, ReadRequest, Script
from twind_drivers.dynamixel.control_tables import ControlTable, TableRegister, table
from twind_drivers.dynamixel.device_layout import RegisterBlock
from twind_drivers.dynamixel.dynamixel_models import facts

# Registers that a calibration or arming depends on; those that a model lacks are left out.
SETTINGS = (
    "return_delay_time",
    "drive_mode",
    "operating_mode",
    "secondary_shadow_id",
    "secondary_id",
    "homing_offset",
    "moving_threshold",
    "max_voltage_limit",
    "min_voltage_limit",
    "pwm_limit",
    "current_limit",
    "velocity_limit",
    "max_position_limit",
    "min_position_limit",
    "startup_configuration",
    "shutdown",
    "electronic_gearratio_numerator",  # Y
    "electronic_gearratio_denominator",
    "torque_enable",
    "status_return_level",
    "hardware_error_status",
)


IDENTITY = ("model_number", "firmware_version")
GAP = 64  # bytes that are read along rather than in two transactions
Settings = dict[str, int]


class IdentificationReader(Protocol):
    """Reader as identification uses it."""

    ids: tuple[int, ...]
    slice: float  # s of bus time that one transaction may take beside a cycle

    def table(self, id: int) -> ControlTable:
        """Return the control table of the model expected at `id`."""

    def span(self, query: Query) -> float:
        """Return the upper bound of a transaction's bus time (s), its timeout excluded."""


def supports_fast(stem: str, firmware: int) -> bool:
    """Return True if this model answers fast sync reads with this firmware (e-manual, "Fast Sync Read")."""
    least = facts(stem).fast_from
    return least is not None and firmware >= least


def find_table(number: int, firmware: int) -> ControlTable | None:
    """Return the table of a model; None where the vendor's files have none."""
    try:
        return table(number, firmware)
    except KeyError:
        return None


def identify(
    bus: IdentificationReader,
) -> Script[tuple[tuple[IdentifiedDevice, ...], dict[int, ControlTable], bool]]:
    """Return the devices that answer, in order; their tables; whether all of them answer fast sync reads.

    Identity and settings come in the same group reads, each a slice of a tick. The answers to a broadcast
    ping take milliseconds an id (`roll_call`), longer than any tick allows. Silent devices, and devices of
    another model than expected, are pinged. A device that answers pings but no reads (status return level 0)
    has no settings.
    """
    expected = {id: bus.table(id) for id in bus.ids}
    found: dict[int, tuple[IdentifiedDevice, ControlTable | None]] = {}
    settings: dict[int, Settings] = {}
    for id, values in (yield from _read(bus, expected, (*IDENTITY, *SETTINGS), eeprom=True)).items():
        number, firmware = (values.pop(name, -1) for name in IDENTITY)
        if number == expected[id].number and firmware >= 0:  # else these bytes mean something else
            found[id] = _device(id, number, firmware)
            settings[id] = values
    strangers = [id for id in bus.ids if id not in found]
    pinged = yield from _ping(bus, strangers)
    tables = {id: known for id, (_, known) in (found | pinged).items() if known is not None}
    others = {id: tables[id] for id in strangers if id in tables}
    settings.update((yield from _read(bus, others, SETTINGS, eeprom=True)))
    for id, values in (yield from _read(bus, tables, SETTINGS, eeprom=False)).items():
        settings.setdefault(id, {}).update(values)
    found.update(pinged)
    devices = tuple(replace(found[id][0], settings=settings.get(id, {})) for id in bus.ids if id in found)
    fast = all(each.id in tables and supports_fast(tables[each.id].stem, each.firmware) for each in devices)
    return devices, tables, fast


def _device(id: int, number: int, firmware: int) -> tuple[IdentifiedDevice, ControlTable | None]:
    """Return a device without its settings, and its table, None for a model outside the vendor's files."""
    found = find_table(number, firmware)
    return IdentifiedDevice(id, number, found.model if found else None, firmware), found


def _ping(
    bus: IdentificationReader, ids: Sequence[int]
) -> Script[dict[int, tuple[IdentifiedDevice, ControlTable | None]]]:
    found = {}
    for id in ids:
        for _ in range(2):  # one lost packet is not a missing device
            data = (yield PingRequest(id)).data.get(id)
            if data is not None:
                found[id] = _device(id, int.from_bytes(data[:2], "little"), data[2])
                break
    return found


def _read(
    bus: IdentificationReader, tables: Mapping[int, ControlTable], names: Sequence[str], *, eeprom: bool
) -> Script[dict[int, Settings]]:
    """Return the values of devices that answer, by the smallest block of each table that holds the names."""
    values: dict[int, Settings] = {}
    for block, ids in _blocks(tables, names, eeprom=eeprom).items():
        found: dict[int, bytes] = {}
        for _ in range(2):  # one lost packet is not a missing device
            missing = [id for id in ids if id not in found]
            for query in _slices(bus, missing, block):
                found.update((yield query).data)
        for id, raw in found.items():
            values.setdefault(id, {}).update(_decode(tables[id], names, block, raw))
    return values


def _slices(bus: IdentificationReader, ids: Sequence[int], block: RegisterBlock) -> list[ReadRequest]:
    """Split a read into reads of as many devices as fit beside a cycle, at least one."""
    one, two = (bus.span(ReadRequest(tuple(ids[:count]), block.address, block.size)) for count in (1, 2))
    count = max(1, floor((bus.slice - one) / (two - one) + 1) if two > one else 1)
    chunks = (tuple(ids[first : first + count]) for first in range(0, len(ids), count))
    return [ReadRequest(chunk, block.address, block.size) for chunk in chunks]


def _blocks(
    tables: Mapping[int, ControlTable], names: Sequence[str], *, eeprom: bool
) -> dict[RegisterBlock, list[int]]:
    """Group ids by the smallest blocks with the named registers (in snake case) of one kind of memory."""
    blocks: dict[RegisterBlock, list[int]] = {}
    for id, each in tables.items():
        fields = [field for name in names if (field := each.fields.get(name)) and field.eeprom is eeprom]
        for part in _near(fields):
            first = part[0].address
            block = RegisterBlock(first, max(field.end for field in part) - first)
            blocks.setdefault(block, []).append(id)
    return blocks


def _near(fields: Sequence[TableRegister]) -> list[list[TableRegister]]:
    """Split registers, sorted by address, where more than `GAP` bytes lie between two."""
    parts: list[list[TableRegister]] = []
    for field in sorted(fields, key=lambda each: each.address):
        if not parts or field.address - parts[-1][-1].end > GAP:
            parts.append([])
        parts[-1].append(field)
    return parts


def _decode(each: ControlTable, names: Sequence[str], block: RegisterBlock, raw: bytes) -> Settings:
    values: Settings = {}
    for name in names:
        field = each.fields.get(name)
        at = block.offset(field) if field else None
        if field and at is not None:
            values[name] = field.decode(raw[at:])
    return values
