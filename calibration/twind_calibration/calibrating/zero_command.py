"""`twindctl calibrate zero`: reads a robot that is held still, and writes the resulting entries. Blocks."""

import argparse
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from twind.client import Client
from twind.command_line.keep_torque_off import limp, require_limp
from twind.command_line.verb import DONE, REFUSED, Rejected, observer, operator
from twind.config.calibrated_device import DeviceRecord
from twind.config.calibration_file import Calibration, JointCalibration, turn_band
from twind.config.counts import slot_angles
from twind.config.robot_spec import RobotFile
from twind.ctl.hint_options import command_hint
from twind_calibration.calibrating import calibration_draft as drafts
from twind_calibration.calibrating.calibration_actuators import CalibrationActuator, slots
from twind_calibration.calibrating.calibration_context import CalibrationContext, ground
from twind_calibration.calibrating.encoder_unwrap import on_turn
from twind_calibration.calibrating.entry_writer import (
    agreed,
    next_steps,
    require_terminal,
    write_entries,
)
from twind_calibration.calibrating.joint_capture import JointCapture, capture, readings
from twind_calibration.calibrating.recorded_devices import differences, records
from twind_calibration.calibrating.zero_placement import (
    TOLERANCE,
    ZeroOffset,
    by_ends,
    by_pose,
    make_entry,
    misfits,
    spread,
)
from twind_calibration.rejection_hints import with_hints
from twind_drivers.clock import MonotonicClock

SPARE = 5  # factor on the requested number of readings, within which every actuator must have so many


@dataclass(frozen=True, slots=True)
class RecordedTravel:
    """Known travel of an actuator, from the draft or from the calibration file."""

    device: DeviceRecord
    sweep: tuple[int, int]


@dataclass(frozen=True, slots=True)
class ZeroResult:
    """Result for one actuator: its new entry, or the reasons against one."""

    slot: CalibrationActuator
    entry: JointCalibration | None
    wrong: tuple[str, ...]
    angle: float | None  # rad that it stood at; None: by the ends of its travel

    @property
    def spread(self) -> float | None:
        """Spread of the zero, ticks; None: unknown."""
        return None if self.entry is None else spread(self.entry)

    def line(self, width: int) -> str:
        """Return the result as one line of text."""
        if self.entry is None:
            return f"NOT  {self.slot.name}: {'; '.join(self.wrong)}"
        where = "by the ends of its travel" if self.angle is None else f"held at {self.angle:+.3f} rad"
        one = self.entry
        known = self.spread
        wide = "unknown" if known is None else f"{known:4.1f} ticks"
        return (
            f"ok   {self.slot.name:<{width}} zero at {one.zero_ticks:>6}, spread {wide}; {where}; "
            f"travel {one.sweep_ticks[0]}..{one.sweep_ticks[1]}"
        )

    def to_json(self) -> dict[str, object]:
        """Return the result as one line of JSON."""
        one = self.entry
        return {
            "joint": self.slot.name,
            "good": one is not None,
            "wrong": list(self.wrong),
            "zero_ticks": None if one is None else one.zero_ticks,
            "sigma_ticks": None if self.spread is None else round(self.spread, 3),
            "captures": None if one is None else one.captures,
            "method": None if one is None else one.method,
            "sweep_ticks": None if one is None else list(one.sweep_ticks),
        }


@with_hints
def zero(options: argparse.Namespace) -> int:
    """Return exit code 0 when the file has all requested actuators.

    Raises Rejected, UsageError, ClientError.
    """
    with operator(options) as client:
        return _zero(options, client)


def _zero(options: argparse.Namespace, client: Client) -> int:
    place = ground(options, client)
    clock = MonotonicClock()
    every = slots(place.robot)
    place.select_actuators(
        options.joints, [slot.name for slot in every]
    )  # a yes to a name that is none is worth nothing
    require_terminal(options)
    calibration = place.calibration()
    draft = drafts.load(place.path, place.robot)
    swept = travels_of(draft, calibration)
    chosen = _select_actuators(options, place, every, draft, swept)
    angles = None if options.from_sweep else parse_angles(options, place, chosen)
    require_limp(client, clock)
    if angles is not None:
        _ask(options, angles, len(chosen))  # a lease does not last as long as a person may take
    found = records(client, place.robot, chosen, {name: each.device for name, each in swept.items()})
    held: Mapping[str, JointCapture] = {}
    with limp(client, clock, take=options.take) as keep:
        if angles is not None:
            with observer(options) as watching:
                held = captured(watching, place.rate_hz, chosen, options.samples, keep)
    placed = [
        place_slot(
            slot, swept[slot.name], found.get(slot.name), held.get(slot.name), (angles or {}).get(slot.name)
        )
        for slot in chosen
    ]
    return _write(options, place, calibration, draft, placed)


def travels_of(draft: drafts.CalibrationDraft, calibration: Calibration | None) -> dict[str, RecordedTravel]:
    """Return the travels by actuator; the draft takes precedence over the file."""
    known = () if calibration is None else calibration.joints
    found = {each.name: RecordedTravel(each.device, each.sweep_ticks) for each in known}
    return found | {name: RecordedTravel(each.device, each.sweep_ticks) for name, each in draft.swept.items()}


def _select_actuators(
    options: argparse.Namespace,
    place: CalibrationContext,
    every: Sequence[CalibrationActuator],
    draft: drafts.CalibrationDraft,
    sweep: Mapping[str, RecordedTravel],
) -> list[CalibrationActuator]:
    """Return the selected actuators. Raises Rejected: none has a sweep, or a named one has none."""
    names = place.select_actuators(options.joints, [slot.name for slot in every])
    unswept = [name for name in names if name not in sweep]
    if options.joints and unswept:
        raise Rejected(
            f"not swept yet: {', '.join(unswept)}: `twindctl calibrate sweep` first, then the zero"
        )
    if not sweep:
        raise Rejected("nothing was swept yet: `twindctl calibrate sweep` first, then the zero")
    pending = options.joints or list(sweep if options.all else draft.swept)
    if not pending:
        raise Rejected(
            "every joint that was swept has a zero: name those that are to get another, or --all for all; "
            "their proofs go"
        )
    return [slot for slot in every if slot.name in names and slot.name in pending]


def parse_angles(
    options: argparse.Namespace, place: CalibrationContext, chosen: Sequence[CalibrationActuator]
) -> dict[str, float]:
    """Return the angle (rad) of each actuator to be read.

    Raises Rejected: no such pose, no such joint, or an angle outside its limits.
    """
    poses = place.robot.poses
    if options.pose is not None and options.pose not in poses:
        raise Rejected(f"{place.robot.name} has no pose {options.pose!r}; it has {', '.join(poses)}")
    pose = poses[options.pose] if options.pose is not None else dict.fromkeys(place.robot.names, 0.0)
    others = dict(options.at)
    place.select_actuators(list(others), place.robot.names)
    stands = slot_angles(place.robot, dict(pose) | others)
    angles = {slot.name: stands[slot.joint.name] for slot in chosen}
    for slot in chosen:
        if not slot.lower - TOLERANCE <= angles[slot.name] <= slot.upper + TOLERANCE:
            turned = _turned(place.robot, slot)
            raise Rejected(
                f"{slot.name} cannot stand at {angles[slot.name]:g} rad: its limits are "
                f"{slot.lower:g}..{slot.upper:g}; `{' '.join(f'--at {name}=RAD' for name in turned)}` gives "
                f"{' and '.join(turned)} another angle"
            )
    return angles


def _turned(robot: RobotFile, slot: CalibrationActuator) -> Sequence[str]:
    """Return the joints that an actuator turns."""
    for each in robot.transmissions:
        if slot.joint.name in each.joints:
            return each.joints
    return (slot.joint.name,)


def _ask(options: argparse.Namespace, angles: Mapping[str, float], count: int) -> None:
    if options.yes:
        return
    name = f"pose {options.pose}" if options.pose else "its zero pose"
    other = [f"{joint} at {angle:+.3f} rad" for joint, angle in angles.items() if angle]
    told = f" ({', '.join(other)}, all others at 0)" if other else " (every joint at 0 rad)"
    print(
        f"hold the robot in {name}{told}: {count} joints are read. ENTER when it stands ", end="", flush=True
    )
    if not sys.stdin.readline():
        raise Rejected("nothing was read")


def captured(
    client: Client, rate: float, chosen: Sequence[CalibrationActuator], count: int, keep: Callable[[], None]
) -> dict[str, JointCapture]:
    """Take this number of readings of each actuator.

    `keep` keeps the actuators limp; it is called at every reading.
    """
    heard: dict[str, list[int]] = {slot.name: [] for slot in chosen}
    stamps = dict.fromkeys(heard, float("-inf"))
    with readings(client, rate) as stream:
        for passed, reading in enumerate(stream):
            keep()
            for name, sample in reading.samples.items():
                if name in heard and sample.time > stamps[name] and len(heard[name]) < count:
                    stamps[name] = sample.time
                    heard[name].append(sample.ticks)
            if all(len(each) == count for each in heard.values()) or passed > SPARE * count:
                break
    return {slot.name: capture(heard[slot.name], slot.joint.type.ticks_per_turn, count) for slot in chosen}


def place_slot(
    slot: CalibrationActuator,
    known: RecordedTravel,
    device: DeviceRecord | None,
    read: JointCapture | None,
    angle: float | None,
) -> ZeroResult:
    """Return the new entry of an actuator, or the reasons against one.

    `angle`: its angle (rad) during the readings; None: the zero is set by the ends of its travel.
    """
    if device is None:
        return ZeroResult(slot, None, ("no device answers there",), angle)
    changed = differences(known.device, device)
    if changed:
        wrong = f"it is not as it was when it was swept: {', '.join(changed)}: sweep it again"
        return ZeroResult(slot, None, (wrong,), angle)
    stands = None
    if angle is None:
        at = by_ends(slot, known.sweep, *_ends(slot))
        wrong = _apart(slot, at)
    else:
        if read is None or read.wrong:
            why = "it was not read" if read is None else f"{read.wrong}: hold it still"
            return ZeroResult(slot, None, (why,), angle)
        at = by_pose(slot, known.sweep, read.mean, read.sigma, read.count, angle)
        stands = on_turn(round(read.mean), turn_band(known.sweep, slot.joint.type.ticks_per_turn))
        wrong = ""
    speaks = [*([wrong] if wrong else []), *misfits(slot, device, known.sweep, at.ticks, stands)]
    entry = None if speaks else make_entry(slot, device, known.sweep, at)
    return ZeroResult(slot, entry, tuple(speaks), angle)


def _ends(slot: CalibrationActuator) -> tuple[float | None, float | None]:
    """Return the angles (rad) of the ends of the travel: described stops, else the limits."""
    stops = slot.joint.stops
    return (stops.lower, stops.upper) if stops.endstops_by_side else (slot.lower, slot.upper)


def _apart(slot: CalibrationActuator, at: ZeroOffset) -> str:
    """Describe two ends whose zeros are too far apart; "" where they are near enough."""
    apart = 2.0 * at.sigma * abs(slot.rad_per_tick)
    if apart <= 2.0 * TOLERANCE:
        return ""
    return (
        f"its two ends tell zeros {apart:.2f} rad apart, at most {2.0 * TOLERANCE:g}: describe its stops "
        "(`stop_rad`), or hold it in a pose"
    )


def describe_coarse_zeros(placed: Sequence[ZeroResult]) -> str:
    """Describe the accuracy of zeros that are set by the ends of the travel."""
    good = [each for each in placed if each.entry is not None]
    known = [each.spread * abs(each.slot.rad_per_tick) for each in good if each.spread is not None]
    one = [each.slot.name for each in good if each.spread is None]
    told = [f"+-{max(known):.3f} rad, and what the hand left out"] if known else []
    told += [f"the accuracy is unknown where only one end is known: {', '.join(one)}"] if one else []
    return f"by the ends of the travel a zero is coarse: {'; '.join(told)}"


def _write(
    options: argparse.Namespace,
    place: CalibrationContext,
    calibration: Calibration | None,
    draft: drafts.CalibrationDraft,
    placed: Sequence[ZeroResult],
) -> int:
    """Show, confirm, write, print the next step; return the exit code."""
    width = max(len(each.slot.name) for each in placed)
    for each in placed:
        print(json.dumps(each.to_json()) if options.json else each.line(width), flush=True)
    entries = [each.entry for each in placed if each.entry is not None]
    if options.from_sweep and entries and not options.json:
        print(describe_coarse_zeros(placed))
        print(
            command_hint(options).prose(
                "a wrong sign fits its ends too: `twindctl calibrate prove` afterwards"
            )
        )
    if not entries:
        raise Rejected("no joint has a zero: nothing was written")
    if not agreed(options, f"write {len(entries)} of {len(placed)} joints to {place.path}?"):
        raise Rejected("nothing was written")
    after = write_entries(place, calibration, entries)
    whole = [each.name for each in entries]
    drafts.change(place.path, place.robot, lambda known: known.after(draft, whole))
    next_steps(options, place, after)
    return DONE if len(entries) == len(placed) else REFUSED
