"""Range of each joint: the tightest of robot file, travel, the actuator's own limits and the model.

For joints of a transmission the whole box of limits must lie within the counts of its actuators.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from twind.config.calibration_file import JointCalibration
from twind.config.counts import angle_of, rad_per_tick, tick_range, ticks_of, turn_start
from twind.config.robot_spec import JointSpec, RobotFile, TransmissionSpec
from twind.exceptions import InvalidInput
from twind.robot.arrays import Floats
from twind.robot.transmission import span
from twind.twin.transmission_range import ActuatorExcess, box

BEYOND = 0.05  # rad, hard limits past the robot file's (docs/reason-codes.md)
ROUNDING = 0.499  # counts: a goal this close to a servo's own limit still rounds to inside it


@dataclass(frozen=True, slots=True)
class JointRange:
    """Range of one joint: accepted, hard, and in counts. rad and ticks."""

    lower: float
    upper: float
    hard_lower: float
    hard_upper: float
    first: int
    last: int


def _direct(
    joint: JointSpec, zero: int, entry: JointCalibration | None, model_range: Floats | None
) -> JointRange:
    """Return the tightest of robot file, measured travel, the servo's own limits and the model."""
    hard_lower = joint.lower - BEYOND
    hard_upper = joint.upper + BEYOND
    if model_range is not None:
        hard_lower = max(hard_lower, float(model_range[0]))
        hard_upper = min(hard_upper, float(model_range[1]))
    least, most = goals(joint, entry)
    if entry is not None:
        ends = sorted(angle_of(joint, zero, ticks) for ticks in entry.sweep_ticks)
        hard_lower = max(hard_lower, ends[0])
        hard_upper = min(hard_upper, ends[1])
    first, last = tick_range(joint, zero, hard_lower, hard_upper)
    first = max(first, least)
    last = min(last, most)
    if first >= last:
        raise InvalidInput(
            f"{joint.name}: no count is inside its limits, its travel and the servo's own {least}..{most} "
            f"(zero {zero}): remount the horn, or correct those (of a servo registers 48 and 52), then "
            "calibrate again"
        )
    # A goal is rounded to the nearest count, which the servo must accept.
    edge = ROUNDING * abs(rad_per_tick(joint))
    own, sent = (sorted(angle_of(joint, zero, u) for u in pair) for pair in ((least, most), (first, last)))
    hard_lower = max(hard_lower, own[0] - edge)
    hard_upper = min(hard_upper, own[1] + edge)
    return JointRange(
        lower=max(joint.lower, hard_lower, sent[0] - edge),
        upper=min(joint.upper, hard_upper, sent[1] + edge),
        hard_lower=hard_lower,
        hard_upper=hard_upper,
        first=first,
        last=last,
    )


def reaches(
    robot: RobotFile, known: Mapping[str, JointCalibration], model: Any, joints: list[int]
) -> tuple[list[int], list[JointRange]]:
    """Return the zero (ticks) and the range of each joint; `joints`: their numbers in the model."""
    entries = [known.get(joint.actuator) for joint in robot.joints]
    zeros = [
        joint.type.centre if entry is None else entry.zero_ticks
        for joint, entry in zip(robot.joints, entries, strict=True)
    ]
    ranges = [model.jnt_range[number] if model.jnt_limited[number] else None for number in joints]
    seats = {
        joint.name: JointActuator(joint, zero, entry, own)
        for joint, zero, entry, own in zip(robot.joints, zeros, entries, ranges, strict=True)
    }
    reach = {
        name: _direct(seat.joint, seat.zero, seat.entry, seat.model_range)
        for name, seat in seats.items()
        if not seat.joint.transmission
    }
    for each in robot.transmissions:
        reach |= zip(each.joints, _linked(each, [seats[name] for name in each.joints]), strict=True)
    return zeros, [reach[name] for name in robot.names]


class JointActuator(NamedTuple):
    """A joint with the data of the actuator that it sits on."""

    joint: JointSpec
    zero: int  # ticks
    entry: JointCalibration | None
    model_range: Floats | None

    @property
    def allowed(self) -> tuple[int, int]:
        """Counts that a goal of the actuator may have: its own limits, and its measured travel."""
        least, most = goals(self.joint, self.entry)
        sweep = (least, most) if self.entry is None else self.entry.sweep_ticks
        return max(least, sweep[0]), min(most, sweep[1])

    @property
    def angles(self) -> tuple[float, float]:
        """`allowed` as angles of the actuator, rad, with the angles that round to them."""
        edge = ROUNDING * abs(rad_per_tick(self.joint))
        ends = sorted(angle_of(self.joint, self.zero, count) for count in self.allowed)
        return ends[0] - edge, ends[1] + edge


def _linked(spec: TransmissionSpec, seats: list[JointActuator]) -> list[JointRange]:
    """Return the ranges of a transmission's joints.

    The whole box of their limits must lie within the counts of its actuators.
    """
    specs = [seat.joint for seat in seats]
    law = spec.law
    ranges = [(-math.inf, math.inf) if seat.model_range is None else seat.model_range for seat in seats]
    limits = np.array([[joint.lower, joint.upper] for joint in specs]).T
    found = box(
        law,
        (limits[0], limits[1]),
        (np.array([low for low, _ in ranges]), np.array([high for _, high in ranges])),
        (np.array([seat.angles[0] for seat in seats]), np.array([seat.angles[1] for seat in seats])),
        BEYOND,
    )
    if isinstance(found, ActuatorExcess):
        seat = seats[found.place]
        counts = sorted(
            ticks_of(seat.joint, seat.zero, angle) if math.isfinite(angle) else 0
            for angle in (found.least, found.most)
        )
        demand = f"limits of {', '.join(spec.joints)} ask actuator {seat.joint.actuator} for counts"
        raise InvalidInput(
            f"{seat.joint.name}: transmission {spec.name}: {demand} {counts[0]}..{counts[1]}; in its travel "
            f"and its own limits are {seat.allowed[0]}..{seat.allowed[1]} alone (zero {seat.zero}): narrow "
            "limits_rad, or remount the horn and calibrate again"
        )
    low, high = span(law, found.hard_lower, found.hard_upper)
    reaches = []
    for place, seat in enumerate(seats):
        ends = sorted(angle / rad_per_tick(seat.joint) for angle in (low[place], high[place]))
        least, most = seat.allowed
        reaches.append(
            JointRange(
                lower=float(found.lower[place]),
                upper=float(found.upper[place]),
                hard_lower=float(found.hard_lower[place]),
                hard_upper=float(found.hard_upper[place]),
                first=max(least, seat.zero + math.floor(ends[0]) - 1),
                last=min(most, seat.zero + math.ceil(ends[1]) + 1),
            )
        )
    return reaches


def goals(joint: JointSpec, entry: JointCalibration | None) -> tuple[int, int]:
    """Return the smallest and the largest goal (counts) that an actuator accepts and reads back unchanged."""
    recorded = None if entry is None else (entry.device.min_ticks, entry.device.max_ticks)
    least, most = joint.type.goals(joint.mode, recorded)
    if entry is not None and joint.type.fenced(joint.mode):  # beyond its one turn it reads another count
        first = turn_begin(joint, entry)
        least = max(least, first)
        most = min(most, first + joint.type.ticks_per_turn - 1)
    return least, most


def turn_begin(joint: JointSpec, entry: JointCalibration | None) -> int:
    """Return the first count of the turn that is read at torque-on in position mode.

    See the e-manual, registers 11 and 20.
    """
    return turn_start(joint.type, 0 if entry is None else entry.device.homing_offset_ticks)
