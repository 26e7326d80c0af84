"""Record of a device in a calibration: its identity and settings when its joint was measured."""

from dataclasses import dataclass
from typing import Annotated

from msgspec import Meta
from msgspec.structs import asdict

from twind.config.config_reader import ConfigReader, ConfigStruct, Plain, Text
from twind_drivers.bus import IdentifiedDevice

MAX_TICKS = 2**31 - 1
Ticks = Annotated[int, Meta(ge=-MAX_TICKS, le=MAX_TICKS)]
Byte = Annotated[int, Meta(ge=0, le=255)]
Tag = Annotated[int, Meta(ge=0, le=1023)]
STAMPED = "moving_threshold"  # 24: where a calibration that uses tags has stamped the servo


@dataclass(frozen=True, slots=True)
class DeviceRecord:
    """Identity and settings of a device when its joint was calibrated."""

    model_number: int
    firmware: int
    unique_id: str | None
    homing_offset_ticks: int
    drive_mode: int
    operating_mode: int
    min_ticks: int
    max_ticks: int
    tag: int | None = None


class EepromKeys(ConfigStruct):
    """Section `eeprom` of a device."""

    homing_offset_ticks: Ticks
    drive_mode: Byte
    operating_mode: Byte
    min_ticks: Ticks
    max_ticks: Ticks


class DeviceKeys(ConfigStruct, kw_only=True):
    """Section `device` of a calibrated joint; `unique_id` and `tag` may be null."""

    model_number: Annotated[int, Meta(ge=0, le=MAX_TICKS)]
    firmware: Annotated[int, Meta(ge=0, le=65535)]
    unique_id: Text | None = None
    tag: Tag | None = None
    eeprom: EepromKeys


def make_device_record(device: IdentifiedDevice, *, tagged: bool = False) -> DeviceRecord:
    """Make the record of a device; `tagged`: with its tag, which only a stamped device has.

    Raises KeyError: a setting that it did not report.
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


def read_device(section: ConfigReader) -> DeviceRecord:
    """The record under `device:`. Raises ConfigError."""
    given = section.drop_nulls("unique_id", "tag").read(DeviceKeys)
    return DeviceRecord(
        given.model_number, given.firmware, given.unique_id, **asdict(given.eeprom), tag=given.tag
    )


def require_sweep(section: ConfigReader, sweep: tuple[int, int]) -> None:
    """Raises ConfigError unless `sweep_ticks` is a travel within 32 bits."""
    first, last = sweep
    if not -MAX_TICKS <= first < last <= MAX_TICKS:
        raise section.refuse("sweep_ticks", f"{first} is not below {last}, or out of 32 bits")


def device_entries(device: DeviceRecord) -> dict[str, Plain]:
    """Return the entries under `device:`."""
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
