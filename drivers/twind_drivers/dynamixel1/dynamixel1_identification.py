"""Identification of the expected devices of a bus of Protocol 1.0, as a script that only reads.

And what speaks against torque: what a servo without watchdog must have right before it is armed.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from twind_drivers.bus import IdentifiedDevice, ReadRequest, Script
from twind_drivers.dynamixel1.dynamixel1_models import NEW_FIRMWARE, TWO, Dynamixel1Model, model_of
from twind_drivers.dynamixel1.dynamixel1_packet import FAULT_BITS, explain
from twind_drivers.dynamixel1.dynamixel1_registers import BLOCKS, CURRENT_MODE, table_of
from twind_drivers.half_duplex.register_table import RegisterTable
from twind_drivers.half_duplex.table_reader import TableReader

IDENTITY = (0, 4)  # address and size: model number, firmware, id
UNLOADING = 0x24  # mask 18: overload, overheating
JOINT = 0
WHEEL = 1
MULTI_TURN = 2
LAST = 4095  # both limits of an MX in multi-turn mode
SLAVE = 0x02  # bit of drive mode (10)
ENDS = {"max_position_limit", "torque_enable"}  # registers of both blocks that every known model has
Settings = dict[str, int]


@dataclass(frozen=True, slots=True)
class FoundDynamixel1:
    """One servo that answers. `grouped`: it answers bulk reads."""

    device: IdentifiedDevice
    table: RegisterTable
    grouped: bool


def identify(bus: TableReader, use_groups: Callable[[int, bool], None]) -> Script[dict[int, FoundDynamixel1]]:
    """Read model, firmware and all settings of every id; return the servos that answer, by id.

    `use_groups(id, on)`: whether the reader may use bulk reads for a device; the test of it needs that.
    """
    identity, errors = yield from _each(bus.ids, *IDENTITY)
    numbers = {id: int.from_bytes(raw[:2], "little") for id, raw in identity.items()}
    kinds = {id: model_of(number) for id, number in numbers.items()}
    groups = {id: True for id, kind in kinds.items() if kind is not None and kind.bulk_read}
    for id in kinds:
        use_groups(id, id in groups)
    for id in (yield from _deaf_to_groups(list(groups), bus.slice_count(IDENTITY[1]))):
        groups[id] = False
        use_groups(id, False)
    settings: dict[int, Settings] = {id: {} for id in kinds}
    for block in (*BLOCKS, CURRENT_MODE):
        known = list(kinds) if block in BLOCKS else [id for id in kinds if _has_current(table_of(kinds[id]))]
        for part in slices(known, bus.slice_count(block[1])):
            reply = yield ReadRequest(part, *block)
            missed = [id for id in part if id not in reply.data]
            again = (yield from _each(missed, *block))[0] if missed else {}
            for id, raw in (dict(reply.data) | again).items():
                settings[id].update(table_of(kinds[id]).values(block[0], raw))
    return {
        id: _found(id, numbers[id], kinds[id], settings[id] | derived(settings[id], errors[id]), groups)
        for id in kinds
        if kinds[id] is None or settings[id].keys() >= ENDS  # else it fell silent in the middle
    }


def _each(ids: Sequence[int], address: int, size: int) -> Script[tuple[dict[int, bytes], dict[int, int]]]:
    """Read a block of each device alone; a silent one gets a second request. Return data and errors."""
    found: dict[int, bytes] = {}
    errors: dict[int, int] = {}
    for _ in range(2):
        for id in [id for id in ids if id not in found]:
            reply = yield ReadRequest((id,), address, size)
            found.update(reply.data)
            errors.update(reply.error)
    return found, errors


def _deaf_to_groups(ids: Sequence[int], count: int) -> Script[list[int]]:
    """Return the devices that answer no bulk read; behind one of those the others are silent, too."""
    deaf: list[int] = []
    rest = list(ids)
    while rest:
        part = tuple(rest[:count])
        for _ in range(2):  # one lost packet is no missing bulk read
            reply = yield ReadRequest(part, *IDENTITY)
            heard = next((place for place, id in enumerate(part) if id not in reply.data), len(part))
            if heard == len(part):
                break
        deaf += part[heard : heard + 1]
        rest = rest[heard + (heard < len(part)) :]
    return deaf


def slices(ids: Sequence[int], count: int) -> list[tuple[int, ...]]:
    """Return the ids in parts of at most `count`."""
    return [tuple(ids[first : first + count]) for first in range(0, len(ids), count)]


def _has_current(table: RegisterTable) -> bool:
    return "torque_control_mode" in table


def _found(
    id: int, number: int, kind: Dynamixel1Model | None, settings: Settings, groups: Mapping[int, bool]
) -> FoundDynamixel1:
    firmware = settings.get("firmware_version", 0)
    name = kind.name if kind is not None else None
    device = IdentifiedDevice(id, number, name, firmware, settings)
    return FoundDynamixel1(device, table_of(kind), groups.get(id, False))


def derived(settings: Mapping[str, int], error: int) -> Settings:
    """Return the settings that no register holds, under the names of other families."""
    ends = (settings.get("min_position_limit", 0), settings.get("max_position_limit", 0))
    mode = WHEEL if ends == (0, 0) else MULTI_TURN if ends == (LAST, LAST) else JOINT
    return {
        "homing_offset": 0,
        "drive_mode": settings.get("drive_mode", 0),
        "operating_mode": mode,
        "hardware_error_status": error & FAULT_BITS,
    }


def foreign_table(number: int, firmware: int) -> str | None:
    """Return why a servo with this number and firmware has other registers, with the remedy; None: not so."""
    kind = model_of(number)
    new = kind is not None and kind.name.startswith("MX") and firmware >= NEW_FIRMWARE
    if not new and number not in TWO:
        return None
    name = TWO.get(number, kind.name if kind is not None else "")
    return (
        f"{name} with firmware {firmware}: from {NEW_FIRMWARE} on it may have the registers of Protocol 2.0. "
        "Use a bus of kind dynamixel2, or restore the firmware of Protocol 1.0 with the vendor's tool"
    )


def objections(number: int, settings: Mapping[str, int]) -> list[str]:
    """Return what speaks against torque on a servo with these settings; empty: nothing."""
    firmware = settings.get("firmware_version", 0)
    other = foreign_table(number, firmware)
    if other is not None:
        return [other]
    if model_of(number) is None:
        return [f"model number {number} is not known here, so its registers are not either: it is only read"]
    found = []
    if settings.get("hardware_error_status", 0):
        found.append(f"it reports an error: {explain(settings['hardware_error_status'])}")
    mode = settings.get("operating_mode", JOINT)
    if mode == WHEEL:
        found.append("both angle limits (6, 8) are 0, wheel mode: it never stops by itself")
    if mode == MULTI_TURN:
        found.append("both angle limits (6, 8) are 4095, multi-turn mode: only joint mode is driven")
    if settings.get("drive_mode", 0) & SLAVE:
        found.append("drive mode (10) is slave: it follows another servo's signal")
    if settings.get("resolution_divider", 1) != 1:
        found.append(f"resolution divider (22) is {settings['resolution_divider']}, not 1")
    if settings.get("torque_control_mode", 0):
        found.append("torque control mode (70) is on: it follows no position")
    if settings.get("shutdown", UNLOADING) & UNLOADING != UNLOADING:
        found.append(f"shutdown mask (18) is {settings['shutdown']}: it lacks overload or overheating")
    if settings.get("max_torque", 1) == 0:
        found.append("max torque (14) is 0: it would accept goals and not move")
    if settings.get("status_return_level", 2) != 2:
        level = settings["status_return_level"]
        found.append(f"status return level (16) is {level}, not 2: it confirms no write")
    return found
