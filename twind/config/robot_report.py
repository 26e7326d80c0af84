"""`twindctl check robot`: a robot file as a table for people, and what is wrong with it beyond its grammar.

Loading has refused all that one file can tell; here stand the worked examples and the cycle
budget. Whether the model has these joints is `twin/binding.py`'s to say.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from twind.config.calibration_file import Calibration
from twind.config.counts import slot_angles, ticks_of
from twind.config.cycle_budget import budgets
from twind.config.robot_spec import JointSpec, RobotFile, TransmissionSpec
from twind.config.travel import has_middle, is_long, travel_refusal
from twind.config.unwatched_type import UnwatchedType

HEADINGS = (
    "joint",
    "bus",
    "id",
    "device",
    "mode",
    "sign",
    "ratio",
    "limits rad",
    "rad/s",
    "rad/s2",
    "counts",
    "zero",
)


@dataclass(frozen=True, slots=True)
class RobotReport:
    """Lines to print, and errors: empty when the robot can be run as described."""

    lines: tuple[str, ...]
    errors: tuple[str, ...]


def check_robot(
    robot: RobotFile, rate_hz: float | None = None, calibration: Calibration | None = None
) -> RobotReport:
    """The robot at `rate_hz` (None: its own). Counts by the calibration, else with zero at mid-encoder."""
    rate = robot.rate_hz if rate_hz is None else rate_hz
    known = {} if calibration is None else calibration.by_name
    zeros = [known[j.actuator].zero_ticks if j.actuator in known else j.type.centre for j in robot.joints]
    rows = [_row(joint, zero) for joint, zero in zip(robot.joints, zeros, strict=True)]
    cycle = budgets(robot, rate)
    zero = "calibrated" if calibration is not None else "taken at mid-encoder: no calibration is read here"
    lines = [
        f"{robot.name}: {_amount(len(robot.joints), 'joint', 'joints')}, "
        f"{_amount(len(robot.buses), 'bus', 'buses')}, support {robot.support}, "
        f"poses {', '.join(robot.poses)}",
        f"description {robot.description_sha256}",
        f"counts at lower and upper limit as the joint turns; zero {zero}",
        *_table([HEADINGS, *rows]),
        *(line for each in robot.transmissions for line in _driven(robot, each, zeros)),
        *_open_items(robot),
        *_unaccepted(robot),
        *_unfenced(robot),
        *_long_travels(robot),
        *(line for each in cycle for line in each.lines),
    ]
    errors = [each.refusal for each in cycle if each.refusal is not None]
    for joint, zero_ticks in zip(robot.joints, zeros, strict=True):
        errors.extend(_unfit(joint))
        errors.extend(_out_of_turn(joint, zero_ticks, joint.actuator in known))
    return RobotReport(tuple(lines), tuple(errors))


def _amount(count: int, one: str, several: str) -> str:
    return f"{count} {one if count == 1 else several}"


def _open_items(robot: RobotFile) -> list[str]:
    """Items of `todo`, in one line."""
    if not robot.todo:
        return []
    refused = "mode live is refused until `twindctl robot finish` has settled them"
    return [f"open: {', '.join(robot.todo)}: {refused}"]


def _unaccepted(robot: RobotFile) -> list[str]:
    """Types without a watchdog that the file does not accept: their devices are refused at identification."""
    kinds = {joint.type.name: joint.type for joint in robot.joints}.values()
    unwatched = [kind for kind in kinds if isinstance(kind, UnwatchedType)]
    return [
        f"warning: a {kind.device} {text}; mode live is refused until then"
        for kind in unwatched
        for text in kind.unaccepted()
    ]


def _unfenced(robot: RobotFile) -> list[str]:
    """Joints whose actuators take goals of many turns: servos but in mode 3, and CAN actuators."""
    names = [joint.name for joint in robot.joints if not joint.type.fenced(joint.mode)]
    if not names:
        return []
    text = "warning: no position limits of the actuator's own, the daemon's clamp is the only fence"
    return [f"{text}: {', '.join(names)}"]


def _long_travels(robot: RobotFile) -> list[str]:
    """Joints whose travel leaves one turn of their actuators, with the turns between their limits."""
    lines = []
    for middle, by in ((True, "in the middle, else "), (False, "")):
        named = [
            f"{joint.name} ({(joint.span[1] - joint.span[0]) * joint.ratio / math.tau:.2f} turns)"
            for joint in robot.joints
            if is_long(joint) and has_middle(joint) == middle
        ]
        text = (
            f"travel beyond one turn, its turn determined after a power-up {by}by `twindctl calibrate turn`"
        )
        lines += [f"{text}: {', '.join(named)}"] if named else []
    return lines


def _row(joint: JointSpec, zero: int) -> tuple[str, ...]:
    lower, upper = _ends(joint, zero)
    whose = f" of {joint.actuator}" if joint.transmission else ""
    return (
        joint.name,
        joint.bus,
        str(joint.id),
        joint.type.device,
        joint.mode,
        f"{joint.sign:+d}",
        f"{joint.ratio:g}",
        f"{joint.lower:g} .. {joint.upper:g}",
        f"{joint.velocity_limit:g}",
        f"{joint.acceleration_limit:g}",
        f"{lower} .. {upper}{whose}",
        str(zero),
    )


def _out_of_turn(joint: JointSpec, zero: int, calibrated: bool) -> list[str]:
    """In position mode a servo takes goals of one turn only; a CAN actuator what its field holds."""
    ends = _ends(joint, zero)
    first, last = joint.type.goals(joint.mode, None)
    if not calibrated or (min(ends) >= first and max(ends) <= last):
        return []  # without calibration the zero is a guess
    where = f"counts {min(ends)}..{max(ends)} leave the servo's turn {first}..{last}"
    name = f"actuators.{joint.actuator}" if joint.transmission else f"joints.{joint.name}"
    return [f"{name}: {where}: remount the horn, then calibrate again"]


def _unfit(joint: JointSpec) -> list[str]:
    """Return what no actuator of this joint can have: its travel, contents of its registers."""
    found = [] if (refusal := travel_refusal(joint)) is None else [refusal]
    found += joint.type.refuse_registers(joint.registers)
    where = f"actuators.{joint.actuator}" if joint.transmission else f"joints.{joint.name}"
    return [f"{where}: {each}" for each in found]


def _ends(joint: JointSpec, zero: int) -> list[int]:
    """Counts of the slot while its joints keep their limits, from the lower end of its angle to the upper."""
    return [ticks_of(joint, zero, angle) for angle in joint.span]


def _driven(robot: RobotFile, one: TransmissionSpec, zeros: Sequence[int]) -> list[str]:
    """Describe a transmission, with counts of its actuators for each joint at its limits, the others at 0."""
    what = (
        f"{one.law}" if one.table is None else f"{one.table.name}, {one.law}, exact to {one.residual:.1g} rad"
    )
    lines = [f"transmission {one.name}: {one.kind} on bus {one.bus}, {what}; condition {one.condition:.3g}"]
    seats = [
        (joint, zero) for joint, zero in zip(robot.joints, zeros, strict=True) if joint.name in one.joints
    ]
    for joint, _ in seats:
        for angle in (joint.lower, 0.0, joint.upper):
            pose = dict.fromkeys(robot.names, 0.0) | {joint.name: angle}
            angles = slot_angles(robot, pose)
            counts = (_count(each, zero, angles[each.name]) for each, zero in seats)
            lines.append(f"  {joint.name} {angle:g} rad: {', '.join(counts)}")
    return lines


def _count(joint: JointSpec, zero: int, angle: float) -> str:
    known = math.isfinite(angle)
    return f"{joint.actuator} {ticks_of(joint, zero, angle) if known else 'not in the table'}"


def _table(rows: Sequence[tuple[str, ...]]) -> list[str]:
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]
