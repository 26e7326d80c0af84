"""Bench devices, named on the command line: without a robot file, or beside those of one.

Runs in `twind-virtual`.
"""

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

from twind.config.driver_family import DriverFamily, family_of
from twind.exceptions import InvalidInput
from twind.virtual.virtual_twin import (
    BenchRequest,
    BusTiming,
    DeviceOptions,
    PhysicsRequest,
    VirtualBusRequest,
    VirtualDevice,
    twin_of,
)
from twind_drivers.virtual.servable_bus import ServableBus

FACTORY = DeviceOptions()


def servo(text: str, options: DeviceOptions = FACTORY) -> tuple[str, Any]:
    """Bus and device of `BUS:ID:MODEL[:FIRMWARE]`, as from the factory but for `options`.

    Raises InvalidInput.
    """
    parts = text.split(":")
    if not 3 <= len(parts) <= 4 or not all(parts):
        raise InvalidInput(f"--servo {text}: it is BUS:ID:MODEL or BUS:ID:MODEL:FIRMWARE")
    bus, id, model = parts[:3]
    version = parts[3] if len(parts) == 4 else None
    return bus, twin_of(family_of(model)).bench_device(BenchRequest(text, id, model, version, options))


def bench(
    servos: Sequence[tuple[str, VirtualDevice]],
    line: BusTiming,
    *,
    baud: int | None = None,
    now: float = 0.0,
) -> dict[str, ServableBus]:
    """Make buses with these devices alone, joints without load. `baud`: bit/s; None: the factory's.

    Raises InvalidInput for a model that cannot be simulated, and for devices of two families on one bus.
    """
    buses: dict[str, ServableBus] = {}
    for name, devices in by_bus(servos).items():
        twin = twin_of(_family(name, devices))
        laid, start = twin.laid_out(devices, line.seed)
        moved = twin.physics(PhysicsRequest(None, (), start, [None] * len(laid), now))
        buses[name] = twin.bus(VirtualBusRequest(name, laid, moved, line, baud, now))
    return buses


def _family(bus: str, devices: Sequence[VirtualDevice]) -> DriverFamily:
    """Return the family of all devices of a bus. Raises InvalidInput: they are of two."""
    found = {family_of(device.model).kind: device for device in devices}
    if len(found) > 1:
        first, second = list(found.values())[:2]
        raise InvalidInput(f"bus {bus}: {first.model} and {second.model} cannot share a wire")
    return family_of(devices[0].model)


Spec = TypeVar("Spec")


def by_bus(servos: Sequence[tuple[str, Spec]]) -> Mapping[str, list[Spec]]:
    """Group the devices by bus, in the order given."""
    found: dict[str, list[Spec]] = {}
    for bus, spec in servos:
        found.setdefault(bus, []).append(spec)
    return found
