"""Identification of the expected devices of a Feetech bus, as a script that only reads. And what speaks
against torque: what a servo without watchdog and without latched errors must have right before it is armed.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from twind_drivers.bus import IdentifiedDevice, ReadRequest, Script
from twind_drivers.feetech.feetech_models import name_of
from twind_drivers.feetech.feetech_packet import explain
from twind_drivers.feetech.feetech_registers import (
    EPROM_END,
    IDENTITY,
    STATE_SIZE,
    RegisterMap,
    map_of_firmware,
)

BLOCKS = ((0, EPROM_END), (EPROM_END, STATE_SIZE))
MULTI_TURN = 0x10  # phase bit 4: the position leaves 0..4095
UNLOADING = 0x24  # mask 19: overload, temperature
ENDS = {"max_position_limit", "torque_enable"}  # registers of both blocks that every driven map has
Settings = dict[str, int]


class SliceReader(Protocol):
    """Reader as identification uses it."""

    ids: tuple[int, ...]

    def slice_count(self, size: int) -> int:
        """Return the devices whose read of `size` bytes fits one transaction."""


@dataclass(frozen=True, slots=True)
class FoundServo:
    """One servo that answers."""

    device: IdentifiedDevice
    map: RegisterMap
    grouped: bool  # it answers sync reads


def identify(bus: SliceReader, use_groups: Callable[[int, bool], None]) -> Script[dict[int, FoundServo]]:
    """Read firmware and all settings of every id; return the servos that answer, by id.

    `use_groups(id, on)`: whether the reader may use sync reads for a device; the test of it needs that.
    """
    identity = yield from _each(bus.ids, *IDENTITY)
    maps = {id: map_of_firmware(*raw[:3]) for id, raw in identity.items()}
    groups: dict[int, bool] = {}
    for id, each in maps.items():
        use_groups(id, each.sync_read)
    for part in _slices([id for id in maps if maps[id].sync_read], bus.slice_count(IDENTITY[1])):
        reply = yield ReadRequest(part, *IDENTITY)
        for id in part:
            groups[id] = id in reply.data
    for id in [id for id, there in groups.items() if not there]:
        use_groups(id, False)
    settings: dict[int, Settings] = {id: {} for id in maps}
    for address, size in BLOCKS:
        for part in _slices(list(maps), bus.slice_count(size)):
            reply = yield ReadRequest(part, address, size)
            missed = [id for id in part if id not in reply.data]
            again = (yield from _each(missed, address, size)) if missed else {}
            for id, raw in (dict(reply.data) | again).items():
                settings[id].update(maps[id].values(address, raw))
    return {
        id: _found(id, identity[id], maps[id], settings[id], groups.get(id, False))
        for id in maps
        if not maps[id].driven or settings[id].keys() >= ENDS  # else it fell silent in the middle
    }


def _each(ids: Sequence[int], address: int, size: int) -> Script[dict[int, bytes]]:
    """Read a block of each device alone; a silent one gets a second request."""
    found: dict[int, bytes] = {}
    for _ in range(2):
        for id in [id for id in ids if id not in found]:
            reply = yield ReadRequest((id,), address, size)
            found.update(reply.data)
    return found


def _slices(ids: Sequence[int], count: int) -> list[tuple[int, ...]]:
    return [tuple(ids[first : first + count]) for first in range(0, len(ids), count)]


def _found(id: int, identity: bytes, own: RegisterMap, settings: Settings, grouped: bool) -> FoundServo:
    number = int.from_bytes(identity[3:5], "big" if own.big_endian else "little")
    firmware = identity[0] * 100 + identity[1]  # 3.10 is 310
    device = IdentifiedDevice(id, number, name_of(number, own.name), firmware, complete(settings))
    return FoundServo(device, own, grouped)


def complete(settings: Mapping[str, int]) -> Settings:
    """Return the settings with those that a servo lacks: no drive mode; an SCS neither offset nor modes."""
    return {"drive_mode": 0, "homing_offset": 0, "operating_mode": 0, **settings}


def objections(own: RegisterMap, settings: Mapping[str, int], *, turns: bool) -> list[str]:
    """Return what speaks against torque on a servo with these settings; empty: nothing.

    `turns`: its goals may leave one turn.
    """
    if not own.driven:
        return ["its firmware is not known here, so its registers are not either: it is only read"]
    found = []
    if settings.get("hardware_error_status", 0):
        found.append(f"it reports an error: {explain(settings['hardware_error_status'])}")
    if settings.get("operating_mode", 0):
        mode = settings["operating_mode"]
        found.append(
            f"operating mode (33) is {mode}, only 0 (position) is driven: a wheel never stops by itself"
        )
    if own.name == "sts" and settings.get("phase", 0) & MULTI_TURN and not turns:
        found.append("phase (18) has bit 4 set: positions leave 0..4095")
    if settings.get("shutdown", UNLOADING) & UNLOADING != UNLOADING:
        found.append(f"unload mask (19) is {settings['shutdown']}: it lacks overload or temperature")
    if settings.get("status_return_level", 1) == 0:
        found.append("response level (8) is 0: it confirms no write")
    limits = (settings.get("min_position_limit", 0), settings.get("max_position_limit", 0))
    if turns and limits != (0, 0):
        found.append(
            f"its limits (9, 11) are {limits[0]}..{limits[1]}, and both must be 0 for more than one turn"
        )
    if settings.get("goal_torque", 1) == 0:
        found.append("goal torque (44) is 0: it would accept goals and not move")
    if own.big_endian and limits == (0, 0):
        found.append("both position limits are 0: it is in motor mode and never stops by itself")
    return found
