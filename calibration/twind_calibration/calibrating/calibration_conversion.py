"""Conversion of measurements from other tools to calibration entries, without loss of counts. Pure.

Present Position = actual + Homing Offset (e-manual, X series): counts under two offsets differ by the
difference of the offsets. A Feetech servo has the opposite sign (`TypeSpec.offset_sign`). The homing offset
of a servo is kept and recorded, and the zero refers to the positions that the servo reports with it.
"""

from dataclasses import dataclass, replace

from twind.config.calibrated_device import DeviceRecord
from twind.config.calibration_file import JointCalibration, turn_band
from twind.config.counts import turn_start
from twind_calibration.calibrating.calibration_actuators import CalibrationActuator
from twind_calibration.calibrating.encoder_unwrap import framed, on_turn
from twind_calibration.calibrating.lerobot_file import LeRobotMotor
from twind_calibration.calibrating.sweep_tracker import describe_mismatch
from twind_calibration.calibrating.travel_verdict import judge
from twind_calibration.calibrating.zero_placement import ZeroOffset, make_entry, misfits

REVERSED = 0b0001  # drive mode (10), bit 0: counts and goals run the other way
DYNAMIXEL = "dynamixel"
FEETECH = "feetech"
Ticks = tuple[int, int]
Convention = int | None  # count at joint angle 0, as the source counts; None: the middle of the travel


@dataclass(frozen=True, slots=True)
class ForeignCalibration:
    """Calibration of one actuator from another tool, in counts under `homing_offset`."""

    travel: Ticks | None  # None: not measured
    homing_offset: int
    drive_mode: int | None = None  # None: it says nothing of it
    make: str | None = None  # of the servos that it is of, as stated by `--make`; None: not stated
    swept: bool = False  # the travel is a sweep of ours, on whatever turn


@dataclass(frozen=True, slots=True)
class ImportResult:
    """The resulting entry, or the reasons against one."""

    slot: CalibrationActuator
    entry: JointCalibration | None
    wrong: tuple[str, ...] = ()
    note: str = ""  # a note for the operator


def of_motor(motor: LeRobotMotor, make: str | None) -> ForeignCalibration:
    """Convert one motor entry of a LeRobot file."""
    return ForeignCalibration((motor.range_min, motor.range_max), motor.homing_offset, motor.drive_mode, make)


def of_registers(slot: CalibrationActuator, device: DeviceRecord, sweep: Ticks | None) -> ForeignCalibration:
    """Convert the registers of a servo: a sweep made with its present settings, else its position limits.

    Factory limits, which span one whole turn, do not count as a travel.
    """
    if sweep is not None:
        return ForeignCalibration(sweep, device.homing_offset_ticks, swept=True)
    limits = (device.min_ticks, device.max_ticks)
    turn = slot.joint.type.ticks_per_turn
    return ForeignCalibration(
        limits if 0 < limits[1] - limits[0] < turn - 1 else None, device.homing_offset_ticks
    )


def convert_entry(
    slot: CalibrationActuator,
    source: ForeignCalibration,
    device: DeviceRecord,
    zero_at: Convention,
    *,
    wide: bool = False,
) -> ImportResult:
    """Build the entry of an actuator whose servo now has the settings `device`.

    `wide`: its travel may be too long.
    """
    refused = _refusal_reason(slot, source, device)
    if refused or source.travel is None:
        return ImportResult(slot, None, (refused,))
    turn = slot.joint.type.ticks_per_turn
    now = device.homing_offset_ticks
    moved = slot.joint.type.offset_sign * (now - source.homing_offset)
    low = source.travel[0] + moved
    high = source.travel[1] + moved
    sweep = framed(low, high, turn_start(slot.joint.type, now), turn)
    zero = (low + high) // 2 if zero_at is None else zero_at + moved
    zero += sweep[0] - low
    if source.swept:
        zero = on_turn(zero, turn_band(sweep, turn))
    judged = judge(slot, sweep[1] - sweep[0])
    wrong = [] if judged.is_acceptable or (wide and judged.wide) else [describe_mismatch(judged)]
    wrong += misfits(slot, device, sweep, zero)
    if wrong:
        return ImportResult(slot, None, tuple(wrong))
    entry = make_entry(slot, device, sweep, ZeroOffset(zero, 0.0, 1, "sweep"))
    return ImportResult(slot, replace(entry, method="import"))


def _refusal_reason(slot: CalibrationActuator, source: ForeignCalibration, device: DeviceRecord) -> str:
    """Return the reason why none of the values is usable; "" where they are."""
    joint = slot.joint
    now = device.homing_offset_ticks
    limit = joint.type.homing_offset_limit
    if limit is None:
        return f"is a {joint.type.device}: registers and files like these say nothing of it"
    if source.make not in (None, _make(slot)):
        return (
            f"is a {joint.type.device}, no {source.make} servo: its encoder and the sign of its homing "
            "offset differ: sweep it"
        )
    if source.travel is None:
        return "its position limits are a whole turn, as delivered: `twindctl calibrate sweep` first"
    low, high = source.travel
    if high - low >= joint.type.ticks_per_turn - 1:
        return f"{low}..{high} is a whole turn, no travel that was measured: `twindctl calibrate sweep`"
    if abs(now) > limit and joint.mode == "position":
        return f"homing_offset is {now}; beyond ±{limit} position mode ignores it: write 0, sweep"
    reversed_since = source.drive_mode is not None and (source.drive_mode ^ device.drive_mode) & REVERSED
    if reversed_since:
        return (
            f"drive_mode is {source.drive_mode}, that of the servo is {device.drive_mode}: its counts "
            "run the other way by now: sweep it"
        )
    return _moved(source, now, limit, _make(slot))


def _make(slot: CalibrationActuator) -> str:
    """Return the make of servos whose homing offset has this sign."""
    return DYNAMIXEL if slot.joint.type.offset_sign > 0 else FEETECH


def _moved(source: ForeignCalibration, now: int, limit: int, make: str) -> str:
    """Return the reason why a count under another homing offset cannot be converted; "" where it can."""
    was = source.homing_offset
    if was == now:
        return ""
    if abs(was) > limit or abs(now) > limit:
        return (
            f"homing_offset is {was}, that of the servo (20) is {now}; beyond ±{limit} it counts in "
            "some operating modes and not in others, so the travel is unknown: sweep it"
        )
    if source.make != make:
        return (
            f"homing_offset is {was}, that of the servo (20) is {now}: `--make {make}` folds it in, if "
            f"the source is of {make} servos"
        )
    return ""
