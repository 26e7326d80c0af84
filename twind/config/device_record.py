"""What a calibration keeps of a device: who it was and what was set when its joint was measured."""

from dataclasses import dataclass

from twind.config.config_section import ConfigSection, Plain
from twind_drivers.bus import IdentifiedDevice

MAX_TICKS = 2**31 - 1
STAMPED = "moving_threshold"  # 24: where a calibration that uses tags has stamped the servo


@dataclass(frozen=True, slots=True)
class DeviceRecord:
    """What was on the wire when the joint was calibrated."""

    model_number: int
    firmware: int
    unique_id: str | None
    homing_offset_ticks: int
    drive_mode: int
    operating_mode: int
    min_ticks: int
    max_ticks: int
    tag: int | None = None


def make_device_record(device: IdentifiedDevice, *, tagged: bool = False) -> DeviceRecord:
    """What a calibration keeps of a device; `tagged`: its tag as well, which only a stamped one has.

    Raises KeyError: a setting that it did not tell.
    """
    settings = device.settings
    return DeviceRecord(
        model_number=device.model_number,
        firmware=device.firmware,
        unique_id=device.unique_id,
        homing_offset_ticks=settings["homing_offset"],
        drive_mode=settings["drive_mode"],
        operating_mode=settings["operating_mode"],
        min_ticks=settings["min_position_limit"],
        max_ticks=settings["max_position_limit"],
        tag=settings[STAMPED] if tagged else None,
    )


def read_device(section: ConfigSection) -> DeviceRecord:
    """The record under `device:`. Raises ConfigError."""
    eeprom = section.section("eeprom")
    number = {"least": -MAX_TICKS, "most": MAX_TICKS}
    byte = {"least": 0, "most": 255}
    record = DeviceRecord(
        model_number=section.integer("model_number", least=0, most=MAX_TICKS),
        firmware=section.integer("firmware", **byte),
        unique_id=None if section.plain("unique_id") is None else section.text("unique_id"),
        homing_offset_ticks=eeprom.integer("homing_offset_ticks", **number),
        drive_mode=eeprom.integer("drive_mode", **byte),
        operating_mode=eeprom.integer("operating_mode", **byte),
        min_ticks=eeprom.integer("min_ticks", **number),
        max_ticks=eeprom.integer("max_ticks", **number),
        tag=None if section.plain("tag") is None else section.integer("tag", least=0, most=1023),
    )
    eeprom.close()
    section.close()
    return record


def device_entries(device: DeviceRecord) -> dict[str, Plain]:
    """What stands under `device:`."""
    eeprom: Plain = {
        "homing_offset_ticks": device.homing_offset_ticks,
        "drive_mode": device.drive_mode,
        "operating_mode": device.operating_mode,
        "min_ticks": device.min_ticks,
        "max_ticks": device.max_ticks,
    }
    found: dict[str, Plain] = {"model_number": device.model_number, "firmware": device.firmware}
    found |= {"unique_id": device.unique_id, "eeprom": eeprom}
    return found if device.tag is None else found | {"tag": device.tag}
