"""Faults of a life: those of the table that a bus knows, in the units of its devices, and their remedies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from numpy.random import Generator

from tests.support.fault_cases import CASES, Case, Order, back_on, healing, order
from twind.config.driver_family import family
from twind.virtual.fault_commands import FaultArguments
from twind.virtual.virtual_twin import twin_of

IDLE = {"free", "replug", "clear", "seed", "record"}
NOMINAL = 12.0  # V, of the table's servos
# Of a CAN bus; those that change what a node is (its zero, its ranges) no command of a client takes back.
CAN_CASES: Mapping[str, Sequence[Case]] = {
    "bus_off": [Case(lambda random: {}, (0.05, 0.6), heal=back_on("bus_off"))],
    "unacknowledged": [Case(lambda random: {}, (0.05, 0.6), heal=back_on("unacknowledged"))],
    "passive": [Case(lambda random: {}, (0.1, 0.6), heal=back_on("passive"))],
    "error_frames": [Case(lambda random: {"count": int(random.integers(1, 200))}, (0.1, 0.5))],
}
CODES = {"damiao": (8, 15), "cubemars": (1, 8), "robstride": (1, 64), "odrive": (1, 1 << 10)}  # of `damage`


class Device(NamedTuple):
    """A device of a bus, and the limits of its joint, rad."""

    id: int
    lower: float
    upper: float


class LifeFault(NamedTuple):
    """A fault by chance: the order, what heals it, and s that it lasts."""

    name: str
    given: Order
    heal: Sequence[Order]
    lasts: float


def known(bus: Any) -> FaultArguments:
    """Orders that a bus takes."""
    return twin_of(family(bus.kind)).faults


def supply(bus: Any) -> float:
    """V that its devices have."""
    if bus.kind == "can":
        return float(bus.nodes.each[0].volts)
    if hasattr(bus.servos, "protection"):
        return float(bus.servos.protection.source)
    return float(bus.servos.volts[0])


def drawn(random: Generator, bus: Any, volts: float, devices: Sequence[Device]) -> LifeFault:
    """A fault of `bus`, which has these devices; without a fault they have so many V."""
    takes = known(bus)
    table = {**CASES, **CAN_CASES} if bus.kind == "can" else CASES
    name = str(random.choice(sorted(table.keys() & takes.keys() - IDLE)))
    case = table[name][int(random.integers(len(table[name])))]
    given = order(name, case, random)
    if "id" in given:
        device = devices[int(given["id"]) % len(devices)]
        given["id"] = device.id
        if name == "hand":
            del given["to"]
            given["rad"] = float(random.uniform(device.lower - 0.3, device.upper + 0.3))
    if name == "damage" and bus.kind == "can":
        codes = CODES[next(each.spec.spoken() for each in bus.nodes.each if each.id == given["id"])]
        given["bits"] = int(random.integers(*codes))
    heal = list(healing(case, given))
    if name == "damage" and bus.kind not in ("can", "dynamixel2"):
        heal.insert(0, given | {"bits": 0})  # a state of these servos, that nothing latches
    for each in (given, *heal):
        if each["fault"] == "supply":
            each["volts"] *= volts / NOMINAL
    fits = [_fitting(each, takes) | {"bus": bus.name} for each in (given, *heal)]
    return LifeFault(name, fits[0], fits[1:], float(random.uniform(*case.lasts)))


def _fitting(given: Order, takes: FaultArguments) -> Order:
    """Without details that only other families have."""
    keys = {key.rstrip("?") for key in takes[given["fault"]]} | {"fault"}
    return {key: value for key, value in given.items() if key in keys}
