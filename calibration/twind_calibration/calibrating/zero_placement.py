"""Zero position of a joint, from a held pose or from the ends of its travel, and its plausibility. Pure."""

from dataclasses import dataclass
from typing import Literal

from twind.config.calibrated_device import DeviceRecord
from twind.config.calibration_file import JointCalibration, seam_margin, turn_band
from twind.config.counts import tick_range, turn_start
from twind_calibration.calibrating.calibration_actuators import CalibrationActuator
from twind_calibration.calibrating.encoder_unwrap import framed, on_turn

TOLERANCE = 0.15  # rad: the described limits may lie so far outside the swept travel, a pose as well

Ticks = tuple[int, int]


@dataclass(frozen=True, slots=True)
class ZeroOffset:
    """Position of joint angle 0, in the frame of the travel."""

    ticks: int
    sigma: float  # ticks
    captures: int
    method: Literal["jig", "sweep", "endstop"]


def travel_of(slot: CalibrationActuator, device: DeviceRecord, seen: Ticks) -> Ticks:
    """Convert lowest and highest count as read to the frame of the calibration file."""
    return framed(
        *seen, turn_start(slot.joint.type, device.homing_offset_ticks), slot.joint.type.ticks_per_turn
    )


def by_pose(
    slot: CalibrationActuator, sweep: Ticks, mean: float, sigma: float, captures: int, angle: float
) -> ZeroOffset:
    """Compute the zero of a joint that stands at `angle` (rad) and reads `mean` ticks, on any turn."""
    band = turn_band(sweep, slot.joint.type.ticks_per_turn)
    turn = on_turn(round(mean), band) - round(mean)
    return ZeroOffset(round(mean + turn - angle / slot.rad_per_tick), sigma, captures, "jig")


def by_ends(slot: CalibrationActuator, sweep: Ticks, lower: float | None, upper: float | None) -> ZeroOffset:
    """Compute the zero of a joint from the angles (rad) of the ends of its travel; None: unknown end.

    Two ends give the mean of two zeros, and half their difference as the spread. One end gives no spread.
    Raises ValueError: no end is known.
    """
    ends = sweep if slot.rad_per_tick > 0.0 else (sweep[1], sweep[0])
    pairs = zip(ends, (lower, upper), strict=True)
    zeros = [ticks - angle / slot.rad_per_tick for ticks, angle in pairs if angle is not None]
    if not zeros:
        raise ValueError("no end of the travel is known")
    return ZeroOffset(round(sum(zeros) / len(zeros)), abs(zeros[0] - zeros[-1]) / 2.0, len(zeros), "sweep")


def spread(entry: JointCalibration) -> float | None:
    """Return the spread of the zero of an entry, ticks; None: a single capture gives no spread."""
    return entry.zero_sigma_ticks if entry.captures > 1 else None


def misfits(
    slot: CalibrationActuator, device: DeviceRecord, sweep: Ticks, zero: int, stands: int | None = None
) -> list[str]:
    """Return the objections to a zero, with likely causes; [] for none. `stands`: present position, ticks."""
    spare = slot.ticks(TOLERANCE)
    first, last = sweep if slot.is_open else tick_range(slot.joint, zero, slot.lower, slot.upper)
    found = []
    beyond = max(sweep[0] - first, last - sweep[1])
    if beyond > spare:
        found.append(
            f"its limits {slot.lower:g}..{slot.upper:g} rad would lie at {first}..{last}, "
            f"{beyond * abs(slot.rad_per_tick):.2f} rad beyond its travel {sweep[0]}..{sweep[1]}: "
            f"{_explain_sign_error(slot, sweep, zero, spare)}"
        )
    if stands is not None and not sweep[0] - spare <= stands <= sweep[1] + spare:
        found.append(f"it stands at {stands}, outside its travel {sweep[0]}..{sweep[1]}: sweep it again")
    if stands is not None:
        found.extend(_other_turn(slot, sweep, stands, spare))
    found.extend(_seam(slot, device, first, last))
    return found


def _explain_sign_error(slot: CalibrationActuator, sweep: Ticks, zero: int, spare: int) -> str:
    """Return the likely cause of a misfit: a wrong sign mirrors the limits about the zero."""
    first, last = tick_range(slot.joint, zero, -slot.upper, -slot.lower)
    if max(sweep[0] - first, last - sweep[1]) <= spare:
        return f"with sign {-slot.joint.sign} they would fit: is its sign wrong, or its pose mirrored?"
    return "was it in another pose, or not swept to both ends?"


def _other_turn(slot: CalibrationActuator, sweep: Ticks, stands: int, spare: int) -> list[str]:
    """Return the objection to a pose that reads as another place in a travel of a turn or more."""
    turn = slot.joint.type.ticks_per_turn
    if sweep[1] - sweep[0] < turn:
        return []
    first = sweep[1] + spare - turn
    last = sweep[0] - spare + turn
    if first < stands < last:
        return []
    middle = f"hold it at {first}..{last}, in the middle, by `--at JOINT=RAD`; or "
    return [
        f"it reads {stands} or a turn of {turn} away, both in its travel {sweep[0]}..{sweep[1]}: "
        f"{middle if first < last else ''}take `--from-sweep`"
    ]


def _seam(slot: CalibrationActuator, device: DeviceRecord, first: int, last: int) -> list[str]:
    """A servo in position mode knows one turn: it goes the long way round (e-manual, operating mode 3)."""
    joint = slot.joint
    turn = slot.joint.type.ticks_per_turn
    if not joint.type.fenced(joint.mode):
        return []
    seam = turn_start(slot.joint.type, device.homing_offset_ticks)
    if (first - seam) // turn != (last - seam) // turn:
        return [
            f"its limits {first}..{last} cross its encoder's seam, which mode {joint.mode} cannot: turn its "
            "horn by a quarter, or take mode extended_position (in the robot file and in the servo); "
            "then sweep it again"
        ]
    if first < slot.start or last >= slot.start + turn:  # of goals, and of the limit registers
        return [
            f"its limits {first}..{last} leave the counts {slot.start}..{slot.start + turn - 1}, beyond "
            f"which mode {joint.mode} takes no goal: its homing_offset is {device.homing_offset_ticks}, "
            "write 0; or turn its horn; then sweep it again"
        ]
    return []


def make_entry(
    slot: CalibrationActuator, device: DeviceRecord, sweep: Ticks, zero: ZeroOffset
) -> JointCalibration:
    """Build the entry of the calibration file, without any proof."""
    joint = slot.joint
    return JointCalibration(
        name=slot.name,
        bus=joint.bus,
        id=joint.id,
        device=device,
        zero_ticks=zero.ticks,
        zero_sigma_ticks=zero.sigma,
        captures=zero.captures,
        sign=joint.sign,
        sweep_ticks=sweep,
        seam_margin_ticks=seam_margin(sweep, joint.type.ticks_per_turn, slot.start),
        turn_band_ticks=turn_band(sweep, joint.type.ticks_per_turn),
        method=zero.method,
    )


def expected_servo_limits(slot: CalibrationActuator, zero: int) -> Ticks | None:
    """Return the Min and Max Position Limit that the servo should have: the joint's limits rounded inwards.

    None: its mode has no such limits. `misfits` reports limits outside the range of the servo.
    """
    joint = slot.joint
    if not joint.type.fenced(joint.mode):
        return None
    return tick_range(joint, zero, slot.lower, slot.upper)
