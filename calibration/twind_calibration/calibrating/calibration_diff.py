"""Differences of two calibrations by actuator, in ticks and in degrees of the joint. Pure."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import degrees
from typing import Any

from twind.config.calibration_file import Calibration, JointCalibration
from twind_calibration.calibrating.calibration_actuators import CalibrationActuator
from twind_calibration.calibrating.recorded_devices import differences

KEPT = ("sign", "captures", "zero_sigma_ticks", "method", "proof")  # told by their values alone


@dataclass(frozen=True, slots=True)
class CalibrationChange:
    """One thing of one actuator that is another one."""

    name: str
    what: str  # of a calibration file's key; "joint": one of the two does not have it at all
    before: Any
    after: Any
    degrees: float | None = None  # by which it moved at the joint; None: no place

    @property
    def _ticks(self) -> int:
        return int(self.after) - int(self.before)

    def __str__(self) -> str:
        if self.what == "joint":
            return "is not there any more" if self.after is None else "is new"
        if self.what == "device":
            return f"device: {'; '.join(self.after)}"
        moved = "" if self.degrees is None else f" ({self._ticks:+d} ticks, {self.degrees:+.2f} deg)"
        return f"{self.what}: {_format_value(self.before)} -> {_format_value(self.after)}{moved}"


def changes(
    before: Calibration, after: Calibration, slots: tuple[CalibrationActuator, ...]
) -> list[CalibrationChange]:
    """Everything that differs, in the robot's order."""
    found: list[CalibrationChange] = []
    for slot in slots:
        old = before.by_name.get(slot.name)
        new = after.by_name.get(slot.name)
        if old is not None and new is not None:
            found.extend(_compare_entries(slot, old, new))
        elif old is not None or new is not None:
            found.append(
                CalibrationChange(slot.name, "joint", old and old.zero_ticks, new and new.zero_ticks)
            )
    return found


def _compare_entries(
    slot: CalibrationActuator, old: JointCalibration, new: JointCalibration
) -> Iterator[CalibrationChange]:
    places = {"zero_ticks": (old.zero_ticks, new.zero_ticks)}
    for end, key in enumerate(("sweep_ticks lower", "sweep_ticks upper")):
        places[key] = old.sweep_ticks[end], new.sweep_ticks[end]
    for what, (was, now) in places.items():
        if was != now:
            yield CalibrationChange(slot.name, what, was, now, degrees((now - was) * slot.rad_per_tick))
    for what in KEPT:
        before = getattr(old, what)
        after = getattr(new, what)
        if before != after:
            yield CalibrationChange(slot.name, what, before, after)
    if device := differences(old.device, new.device):
        yield CalibrationChange(slot.name, "device", [], device)


def _format_value(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, dict):
        return ", ".join(f"{key} {_format_value(item)}" for key, item in value.items())
    return f"{value:g}" if isinstance(value, float) else str(value)
