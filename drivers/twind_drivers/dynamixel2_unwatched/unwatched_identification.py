"""Identification of XL-320 and PRO -R, as a script that only reads; and what speaks against torque on one."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from twind_drivers.bus import IdentifiedDevice, ReadRequest, Script
from twind_drivers.dynamixel.dynamixel_identification import find_table
from twind_drivers.dynamixel2_unwatched.unwatched_models import UnwatchedModel, model_of
from twind_drivers.dynamixel2_unwatched.unwatched_registers import IDENTITY, layout_of
from twind_drivers.dynamixel2_unwatched.unwatched_slow_registers import SHUT_DOWN
from twind_drivers.half_duplex.table_reader import TableReader

FIRMWARE = 6  # address, in the tables of all models but the XL-320
Settings = dict[str, int]


@dataclass(frozen=True, slots=True)
class ServoKind:
    """Settings that servos of one table need, and their error bits."""

    mode: int  # of register 11, the only one that is driven
    wrong_mode: str  # refusal of another one, to be formatted with it
    mask: int  # address of the shutdown mask ...
    unloading: int  # ... and the bits that it must have
    faults: Mapping[int, str]  # bits of `hardware_error_status`


def kind_of(table: str) -> ServoKind:
    """Return the kind of a table. Source: "Control Mode (11)", "Operating Mode (11)", "Shutdown (18, 48)"."""
    if table == "xl320":
        faults = {0x01: "overload", 0x02: "overheating", 0x04: "supply voltage"}
        return ServoKind(2, "control mode (11) is {}, not 2: a wheel never stops", 18, 0x03, faults)
    faults = {
        0x01: "supply voltage",
        0x02: "hall sensor",
        0x04: "overheating",
        0x08: "encoder",
        0x10: "electrical shock",
        0x20: "overload",
    }
    return ServoKind(3, "operating mode (11) is {}, not 3 (position)", 48, 0x20, faults)


def identify(bus: TableReader, table: str) -> Script[dict[int, IdentifiedDevice]]:
    """Read model, firmware and settings of every id; return the devices that reply.

    `table`: of the bus. A device with another table has no settings: its bytes mean something else.
    """
    identity = yield from _read(bus, bus.ids, *IDENTITY)
    kinds = {id: model_of(int.from_bytes(raw[:2], "little")) for id, raw in identity.items()}
    own = [id for id, kind in kinds.items() if kind is not None and kind.table == table]
    layout = layout_of(table)
    settings: dict[int, Settings] = {id: {} for id in own}
    for block in layout.settings:
        for id, raw in (yield from _read(bus, own, *block)).items():
            settings[id].update(layout.table.values(block[0], raw))
    devices = {}
    for id, raw in identity.items():
        found = settings.get(id, {})
        if id in own and "hardware_error_status" not in found:
            continue  # it fell silent in the middle
        devices[id] = _device(id, raw, kinds[id], found and derived(found))
    return devices


def _device(id: int, raw: bytes, kind: UnwatchedModel | None, settings: Settings) -> IdentifiedDevice:
    number = int.from_bytes(raw[:2], "little")
    firmware = settings.get("firmware_version", raw[FIRMWARE])
    other = find_table(number, firmware) if kind is None else None
    name = kind.name if kind is not None else other.model if other is not None else None
    return IdentifiedDevice(id, number, name, firmware, settings)


def _read(bus: TableReader, ids: Sequence[int], address: int, size: int) -> Script[dict[int, bytes]]:
    """Read a block; silent devices get a second request and are left out if they stay silent."""
    found: dict[int, bytes] = {}
    count = bus.slice_count(size)
    for _ in range(2):
        missing = [id for id in ids if id not in found]
        for first in range(0, len(missing), count):
            found.update((yield ReadRequest(tuple(missing[first : first + count]), address, size)).data)
    return found


def derived(settings: Mapping[str, int]) -> Settings:
    """Return the settings with those that no register holds, under the names of other families."""
    mode = {"operating_mode": settings["control_mode"]} if "control_mode" in settings else {}
    return {"homing_offset": 0, "drive_mode": 0} | dict(settings) | mode


def explain_fault(table: str, bits: int) -> str:
    """Return the meaning of a hardware error, in words."""
    texts = [text for bit, text in kind_of(table).faults.items() if bits & bit]
    if bits & SHUT_DOWN:
        texts.append("shut down by an alarm (torque limit is 0)")
    return ", ".join(texts) or f"bits {bits}"


def objections(table: str, number: int, settings: Mapping[str, int]) -> list[str]:
    """Return what speaks against torque on a servo with these settings; empty: nothing."""
    known = model_of(number)
    if known is None or known.table != table:
        return [f"model number {number} has other registers than this bus: it is only read"]
    layout = layout_of(table)
    kind = kind_of(table)
    found = []
    fault = settings.get("hardware_error_status", 0)
    if fault:
        found.append(
            f"it reports an error: {explain_fault(table, fault)}; restart it after the cause is gone"
        )
    mode = settings.get("operating_mode", kind.mode)
    if mode != kind.mode:
        found.append(kind.wrong_mode.format(mode))
    mask = settings.get("shutdown", kind.unloading)
    if mask & kind.unloading != kind.unloading:
        lacking = explain_fault(table, kind.unloading & ~mask)
        found.append(f"shutdown mask ({kind.mask}) is {mask}: it lacks {lacking}")
    if settings.get(layout.most, 1) == 0:
        found.append(f"{layout.most} is 0: it would accept goals and not move")
    level = settings.get("status_return_level", 2)
    if level != 2:
        found.append(f"status return level is {level}, not 2: it confirms no write")
    return found
