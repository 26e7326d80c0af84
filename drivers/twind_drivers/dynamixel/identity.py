"""Who is on a bus: identification of the devices that are expected there. A script that only reads."""

import re
from collections.abc import Mapping, Sequence
from typing import Protocol

from twind_drivers.bus import Device, NoReply, Ping, Reply, Script
from twind_drivers.dynamixel.layout import Block
from twind_drivers.dynamixel.tables import Table, table

# What a calibration depends on and what arming must know; those that a model lacks are left out.
SETTINGS = (
    "return_delay_time",
    "drive_mode",
    "operating_mode",
    "homing_offset",
    "current_limit",
    "velocity_limit",
    "max_position_limit",
    "min_position_limit",
    "startup_configuration",
    "shutdown",
    "torque_enable",
    "status_return_level",
    "hardware_error_status",
)


class Asker(Protocol):
    """What identification needs of a reader."""

    ids: tuple[int, ...]

    def collect(self, ids: Sequence[int], address: int, size: int) -> Script[Mapping[int, bytes]]:
        """One block of several devices."""


def supports_fast(stem: str, firmware: int) -> bool:
    """Does this model answer fast sync reads from this firmware on? (e-manual, "Fast Sync Read".)"""
    if re.match(r"x[a-z](430|540)", stem):  # not 2XL430 and 2XC430
        return firmware >= 45
    if re.match(r"x[a-z]330", stem):
        return firmware >= 46
    if stem.startswith("rh_p12"):
        return firmware >= 13
    return stem.startswith(("ph", "pm")) and firmware >= 12


def known(number: int, firmware: int) -> Table | None:
    """The table of a model, None where the vendor's files have none."""
    try:
        return table(number, firmware)
    except KeyError:
        return None


def device(id: int, reply: Reply) -> tuple[Device, Table | None] | None:
    """What the answer to a ping says; None: it did not answer."""
    data = reply.data.get(id)
    if data is None:
        return None
    number, firmware = int.from_bytes(data[:2], "little"), data[2]
    found = known(number, firmware)
    return Device(id, number, found.model if found else None, firmware), found


def identify(bus: Asker) -> Script[tuple[tuple[Device, ...], dict[int, Table], bool]]:
    """Devices that answer, in order; their tables; whether all of them answer fast sync reads.

    A device that answers pings but not reads (status return level 0) has no settings.
    """
    found: dict[int, Device] = {}
    tables: dict[int, Table] = {}
    for id in bus.ids:
        for _ in range(2):  # one lost packet is not a missing device
            seen = device(id, (yield Ping(id)))
            if seen is not None:
                found[id] = seen[0]
                tables.update({id: seen[1]} if seen[1] else {})
                break
    settings = yield from _settings(bus, tables)
    devices = tuple(
        Device(each.id, each.model_number, each.model_name, each.firmware, settings.get(each.id, {}))
        for each in found.values()
    )
    fast = all(each.id in tables and supports_fast(tables[each.id].stem, each.firmware) for each in devices)
    return devices, tables, fast


def _settings(bus: Asker, tables: Mapping[int, Table]) -> Script[dict[int, dict[str, int]]]:
    """Two blocks of each device, EEPROM and RAM, by the table of the model that is really there."""
    settings: dict[int, dict[str, int]] = {}
    for eeprom in (True, False):
        for block, ids in _blocks(tables, eeprom=eeprom).items():
            try:
                data = yield from bus.collect(ids, block.address, block.size)
            except NoReply as silent:
                answering = [id for id in ids if id not in silent.ids]
                data = (yield from bus.collect(answering, block.address, block.size)) if answering else {}
            for id, raw in data.items():
                settings.setdefault(id, {}).update(_decode(tables[id], block, raw))
    return settings


def _blocks(tables: Mapping[int, Table], *, eeprom: bool) -> dict[Block, list[int]]:
    """Ids by the smallest block that holds their settings of one kind of memory."""
    blocks: dict[Block, list[int]] = {}
    for id, each in tables.items():
        fields = [each[name] for name in SETTINGS if name in each and each[name].eeprom is eeprom]
        if fields:
            first = min(field.address for field in fields)
            block = Block(first, max(field.end for field in fields) - first)
            blocks.setdefault(block, []).append(id)
    return blocks


def _decode(each: Table, block: Block, raw: bytes) -> dict[str, int]:
    values: dict[str, int] = {}
    for name in SETTINGS:
        at = block.offset(each[name]) if name in each else None
        if at is not None:
            values[name] = each[name].decode(raw[at:])
    return values
