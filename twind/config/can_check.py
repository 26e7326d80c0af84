"""Is a CAN actuator one that a joint can have? What it told of itself in, texts out. Pure.

Many cannot say which model they are: what their registers say of their ranges is compared instead. A wrong
range is a wrong position, and a wrong torque.
"""

from collections.abc import Iterator

from twind.config.actuator_types import TAKES_COMMANDS, CanType
from twind_drivers.bus import IdentifiedDevice

# What a driver gives of the ranges that a device told, in thousandths -> key of the robot file, unit.
TOLD = {
    "pmax_milli": ("position_rad", "rad"),
    "vmax_milli": ("velocity_rad_s", "rad/s"),
    "tmax_milli": ("torque_nm", "N·m"),
}
SAME = 1  # thousandths: how far a range may be off by rounding


def unfit(kind: CanType, device: IdentifiedDevice) -> Iterator[str]:
    """What makes this actuator unusable for a joint of `kind`, whatever the calibration says."""
    if device.model_name is not None and device.model_name != kind.device:
        number = f"model number {device.model_number}"
        yield f"is {device.model_name} ({number}), the robot file says {kind.device}"
    mode = device.settings.get("operating_mode")
    if mode != TAKES_COMMANDS:
        yield (
            f"its operating mode is {mode}: it does not take the commands of the {kind.family} family; "
            "set that mode by the vendor's tool, or by its register with torque off"
        )
    for told, (key, unit) in TOLD.items():
        value = device.settings.get(told)
        described = getattr(kind.ranges, key)
        if value is not None and abs(value - round(1e3 * described)) > SAME:
            yield (
                f"its frames span {value / 1e3:g} {unit}, the robot file says {described:g}: "
                f"a wrong range is a wrong reading; correct ranges.{key} of type {kind.name}, "
                "or the register of the device"
            )
