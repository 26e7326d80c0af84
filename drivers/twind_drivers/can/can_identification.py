"""Identification of the devices on a CAN bus: state of all, then their registers. A script."""

from collections.abc import Mapping
from math import isfinite

from twind_drivers.bus import IdentifiedDevice, ReadRequest, Script
from twind_drivers.can.actuator_group import ActuatorGroup
from twind_drivers.can.can_models import model
from twind_drivers.can.can_units import counts
from twind_drivers.can.register_access import STATE, decode, read_register

TRIES = 2  # requests before a device counts as silent or without the register; one may be lost
CHIP = ("mcu_high", "mcu_low")  # halves of the unique number of its processor, where it reports it
REPORTED_RANGES = {
    "position_range": "pmax_milli",
    "velocity_range": "vmax_milli",
    "torque_range": "tmax_milli",
}


def identify(fleet: ActuatorGroup, count: int) -> Script[tuple[IdentifiedDevice, ...]]:
    """Return the devices that answer, in order of ids; reads registers of `count` devices at once.

    Ranges that the devices report replace those described. A register that stays unanswered twice is not
    among the settings: boards and firmwares differ in their registers.
    """
    present = yield from _present(fleet)
    values: dict[int, dict[str, float]] = {id: {} for id in present}
    for family, rows in fleet.families:
        own = [fleet.ids[row] for row in rows if fleet.ids[row] in present]
        for name in family.identity:
            parameter = family.parameters[name]
            found, _ = yield from read_register(own, parameter, count, TRIES)
            for id, data in found.items():
                values[id][name] = decode(parameter, data)
    return tuple(_device(fleet, id, values[id]) for id in present)


def _present(fleet: ActuatorGroup) -> Script[list[int]]:
    found: set[int] = set()
    for _ in range(TRIES):
        missing = tuple(id for id in fleet.ids if id not in found)
        if missing:
            found |= (yield ReadRequest(missing, STATE, 3)).data.keys()
    return [id for id in fleet.ids if id in found]


def _device(fleet: ActuatorGroup, id: int, values: Mapping[str, float]) -> IdentifiedDevice:
    """Build the settings to compare with the calibration, under the register names of serial servos."""
    row = fleet.row(id)
    family, place = fleet.family_of_row(row)
    known = {name: value for name, value in values.items() if isfinite(value)}
    fleet.learn(
        row, {name: value for name, value in known.items() if name not in REPORTED_RANGES or value > 0.0}
    )
    span = float(family.ranges.position[place])
    edge = int(counts(span)) if isfinite(span) else 0
    settings = {
        "homing_offset": 0,
        "drive_mode": 0,
        "operating_mode": family.operating_mode(known),
        "min_position_limit": -edge,
        "max_position_limit": edge,
    }
    settings |= {
        REPORTED_RANGES[name]: round(value * 1e3) for name, value in known.items() if name in REPORTED_RANGES
    }
    whole = {
        name: int(value)
        for name, value in known.items()
        if value == int(value) and name not in REPORTED_RANGES
    }
    described = model(fleet.actuators[row].model)
    firmware = int(known.get("firmware", 0)) & 0xFF
    chip = [known[half] for half in CHIP if half in known]
    unique = "".join(f"{int(half):08x}" for half in chip) if len(chip) == len(CHIP) else None
    # No actuator reports its model: number and name are those of the robot file.
    return IdentifiedDevice(id, described.number, described.name, firmware, {**whole, **settings}, unique)
