"""What is on the wire now, as a calibration records it, and in what it differs from what was recorded."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

from twind.client import Client
from twind.config.calibration_file import DeviceRecord, recorded
from twind.config.robot_spec import RobotFile
from twind.ctl.verb import Rejected
from twind_calibration.calibrating.ground import scanned
from twind_calibration.calibrating.slots import Slot
from twind_drivers.bus import Device

# Of a record: what people call it.
NAMES = {
    "homing_offset_ticks": "homing_offset (20)",
    "drive_mode": "drive_mode (10)",
    "operating_mode": "operating_mode (11)",
    "min_ticks": "min_position_limit (52)",
    "max_ticks": "max_position_limit (48)",
}


def records(client: Client, robot: RobotFile, slots: Sequence[Slot]) -> dict[str, DeviceRecord]:
    """By actuator, of those who answer. Raises Rejected: one that does not tell its settings; ClientError."""
    found: dict[str, DeviceRecord] = {}
    for bus in robot.buses:
        present = scanned(client, bus.name)
        for slot in slots:
            told = present.get(slot.joint.id) if slot.joint.bus == bus.name else None
            if told is not None:
                found[slot.name] = _record(slot, told)
    return found


def _record(slot: Slot, told: Mapping[str, Any]) -> DeviceRecord:
    settings = {name: int(value) for name, value in (told.get("settings") or {}).items()}
    firmware = int(told.get("firmware") or 0)
    name, unique = told.get("model_name"), told.get("unique_id")
    device = Device(slot.joint.id, int(told["model"]), name, firmware, settings, unique)
    try:
        return recorded(device)
    except KeyError as error:
        raise Rejected(
            f"{slot.name} (bus {slot.joint.bus} id {slot.joint.id}) does not tell its {error.args[0]}: is "
            "its status return level (68) 2? Try again, or `twindctl doctor`"
        ) from None


def differences(then: DeviceRecord, now: DeviceRecord) -> list[str]:
    """In what a device is another than it was, in words; [] for nothing."""
    return [
        f"{NAMES.get(each.name, each.name)} is {getattr(now, each.name)}, was {getattr(then, each.name)}"
        for each in fields(DeviceRecord)
        if getattr(now, each.name) != getattr(then, each.name)
    ]
