"""Devices on the wire in the form that a calibration records, and their differences from the records."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import fields
from types import MappingProxyType
from typing import Any

from twind.client import Client
from twind.command_line.verb import Rejected
from twind.config.calibrated_device import STAMPED, DeviceRecord, make_device_record
from twind.config.calibration_file import Calibration
from twind.config.robot_spec import RobotFile
from twind_calibration.calibrating.calibration_actuators import CalibrationActuator
from twind_calibration.calibrating.calibration_context import scanned
from twind_drivers.bus import IdentifiedDevice

# Of a record: what people call it.
NAMES = {
    "homing_offset_ticks": "homing_offset",
    "drive_mode": "drive_mode",
    "operating_mode": "operating_mode",
    "min_ticks": "min_position_limit",
    "max_ticks": "max_position_limit",
    "tag": STAMPED,
}
FENCE = ("min_ticks", "max_ticks")  # what `limits` puts right


def records(
    client: Client,
    robot: RobotFile,
    slots: Sequence[CalibrationActuator],
    known: Mapping[str, DeviceRecord] = MappingProxyType({}),
) -> dict[str, DeviceRecord]:
    """Return a record of each actuator that answers, by actuator name.

    `known`: the earlier records; where one has a tag, the tag is read again. Raises Rejected: a device does
    not report its settings; ClientError.
    """
    found: dict[str, DeviceRecord] = {}
    for bus in robot.buses:
        present = scanned(client, bus.name)
        for slot in slots:
            told = present.get(slot.joint.id) if slot.joint.bus == bus.name else None
            if told is not None:
                then = known.get(slot.name)
                found[slot.name] = _record(slot, told, tagged=then is not None and then.tag is not None)
    return found


def _record(slot: CalibrationActuator, reply: Mapping[str, Any], *, tagged: bool) -> DeviceRecord:
    settings = {name: int(value) for name, value in (reply.get("settings") or {}).items()}
    firmware = int(reply.get("firmware") or 0)
    name = reply.get("model_name")
    unique = reply.get("unique_id")
    device = IdentifiedDevice(slot.joint.id, int(reply["model"]), name, firmware, settings, unique)
    try:
        return make_device_record(device, tagged=tagged)
    except KeyError as error:
        raise Rejected(
            f"{slot.name} (bus {slot.joint.bus} id {slot.joint.id}) does not tell its {error.args[0]}: is "
            "its status return level (68) 2? Try again, or `twindctl doctor`"
        ) from None


def of_file(calibration: Calibration | None) -> dict[str, DeviceRecord]:
    """Return the device records of a calibration, by actuator."""
    return {} if calibration is None else {each.name: each.device for each in calibration.joints}


def differences(then: DeviceRecord, now: DeviceRecord, but: Collection[str] = ()) -> list[str]:
    """Describe the differences of a device from its record, fields `but` left out; [] for none."""
    return [
        f"{NAMES.get(each.name, each.name)} is {getattr(now, each.name)}, was {getattr(then, each.name)}"
        for each in fields(DeviceRecord)
        if each.name not in but and getattr(now, each.name) != getattr(then, each.name)
    ]
