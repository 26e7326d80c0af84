"""`twindctl calibrate limits`: registers of servos and the record of them, written together. Blocks.

What a servo holds decides what is written to it, whatever its record says: so the same command brings both to
agreement after whatever ended it half-way.
"""

import argparse
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from twind.client import CallError, Client, ClientError
from twind.command_line.keep_torque_off import limp, require_limp
from twind.command_line.verb import DONE, Rejected, operator
from twind.config.atomic_save import LockedFolder
from twind.config.calibrated_device import DeviceRecord
from twind.config.calibration_file import Calibration, JointCalibration
from twind.ctl.hint_options import command_hint
from twind_calibration.calibrating import file_ownership
from twind_calibration.calibrating.calibration_actuators import CalibrationActuator, slots
from twind_calibration.calibrating.calibration_context import CalibrationContext, ground
from twind_calibration.calibrating.calibration_steps import format_option
from twind_calibration.calibrating.entry_writer import (
    agreed,
    next_steps,
    require_terminal,
    unchanged,
    write_entries,
)
from twind_calibration.calibrating.recorded_devices import FENCE, differences, of_file, records
from twind_calibration.calibrating.zero_placement import expected_servo_limits, misfits
from twind_calibration.rejection_hints import with_hints
from twind_drivers.clock import MonotonicClock

LEAST = "min_position_limit"
MOST = "max_position_limit"


@dataclass(frozen=True, slots=True)
class ServoLimitChange:
    """Present and wanted position limits of one servo."""

    slot: CalibrationActuator
    entry: JointCalibration
    held: tuple[int, int]  # by the servo
    wanted: tuple[int, int]

    @property
    def recorded_limits(self) -> tuple[int, int]:
        """By the calibration file."""
        return self.entry.device.min_ticks, self.entry.device.max_ticks

    @property
    def writes(self) -> list[tuple[str, int]]:
        """Writes for the differing limits, ordered so that the lower limit never passes the upper one."""
        low = (LEAST, self.wanted[0])
        high = (MOST, self.wanted[1])
        order = [high, low] if self.wanted[0] > self.held[0] else [low, high]
        held = dict(zip((LEAST, MOST), self.held, strict=True))
        return [(name, value) for name, value in order if held[name] != value]

    def entry_with(self, held: tuple[int, int]) -> JointCalibration:
        """Its entry when the servo holds that."""
        return replace(self.entry, device=replace(self.entry.device, min_ticks=held[0], max_ticks=held[1]))

    def line(self, width: int) -> str:
        """For a person."""
        then, now = (f"{first}..{last}" for first, last in (self.held, self.wanted))
        radians = f"{self.slot.lower:g}..{self.slot.upper:g} rad"
        other = (
            ""
            if self.held == self.recorded_limits
            else f"; recorded as {self.recorded_limits[0]}..{self.recorded_limits[1]}"
        )
        return f"{self.slot.name:<{width}} {then:>12} -> {now:<12} {radians}{other}"


@with_hints
def limits(options: argparse.Namespace) -> int:
    """Exit code 0: done, or nothing to do. Raises Rejected, UsageError, ClientError."""
    with operator(options) as client:
        return _limits(options, client)


def _limits(options: argparse.Namespace, client: Client) -> int:
    place = ground(options, client)
    clock = MonotonicClock()
    place.select_actuators(options.joints, [slot.name for slot in slots(place.robot)])
    require_terminal(options)
    if client.call("GetStatus")["status"]["mode"] != "live":
        raise Rejected("registers are written in mode live alone: `twindctl mode live`, then again")
    calibration = place.calibration()
    if calibration is None:
        raise Rejected(f"{place.path} is not there: `twindctl calibrate sweep`, then `zero`, first")
    chosen = _select_actuators(options, place, calibration)
    require_limp(client, clock)
    found = records(client, place.robot, chosen, of_file(calibration))
    fences = fences_of(chosen, calibration, found)
    width = max((len(each.slot.name) for each in fences), default=0)
    if not fences:
        _print_line(options, "every servo has the limits of its joint, or a mode that knows none")
        return DONE
    for each in fences:
        _print_line(options, each.line(width))
    if not agreed(options, f"write these limits to {len(fences)} servos?"):
        raise Rejected("nothing was written")
    # Locked, so that no other program replaces the zero that the limits are derived from.
    with file_ownership.lock_folder(place.path) as folder:
        unchanged(place, calibration, [each.slot.name for each in fences])
        with limp(client, clock, take=options.take) as keep:
            return carry_out(options, client, place, calibration, fences, keep, folder)


def _select_actuators(
    options: argparse.Namespace, place: CalibrationContext, calibration: Calibration
) -> list[CalibrationActuator]:
    """Raises Rejected: one that was named is not calibrated."""
    every = slots(place.robot)
    names = place.select_actuators(options.joints, [slot.name for slot in every])
    missing = [name for name in names if name not in calibration.by_name]
    if options.joints and missing:
        raise Rejected(
            f"not calibrated: {', '.join(missing)}: `twindctl calibrate sweep`, then `zero`, first"
        )
    return [slot for slot in every if slot.name in names and slot.name in calibration.by_name]


def fences_of(
    chosen: Sequence[CalibrationActuator], calibration: Calibration, found: Mapping[str, DeviceRecord]
) -> list[ServoLimitChange]:
    """Those whose servo or record has other limits. Raises Rejected: one that they are not written to."""
    fences = []
    for slot in chosen:
        entry = calibration.by_name[slot.name]
        device = found.get(slot.name)
        wanted = expected_servo_limits(slot, entry.zero_ticks)
        if wanted is None:
            continue
        now = device or entry.device
        each = ServoLimitChange(slot, entry, (now.min_ticks, now.max_ticks), wanted)
        if not each.held == each.recorded_limits == each.wanted:
            _require_fit(each, device)
            fences.append(each)
    return fences


def _require_fit(each: ServoLimitChange, device: DeviceRecord | None) -> None:
    """Raises Rejected: the servo is not as its calibration has it, limits aside, or has no room for them."""
    entry = each.entry
    name = each.slot.name
    changed = ["no device answers there"] if device is None else differences(entry.device, device, but=FENCE)
    if changed:
        raise Rejected(
            f"{name} is not as it was calibrated: {', '.join(changed)}: put that right first, or "
            "calibrate it anew"
        )
    if wrong := misfits(each.slot, entry.device, entry.sweep_ticks, entry.zero_ticks):
        raise Rejected(f"{name}: {'; '.join(wrong)}")


def carry_out(
    options: argparse.Namespace,
    client: Client,
    place: CalibrationContext,
    calibration: Calibration,
    fences: Sequence[ServoLimitChange],
    keep: Callable[[], None],
    folder: LockedFolder,
) -> int:
    """Each servo whole, then the file; what was written is recorded whatever ends it."""
    entries: list[JointCalibration] = []
    try:
        for each in fences:
            keep()
            least, most = _write(client, each)
            entries.append(each.entry_with((least, most)))
            if options.json:
                print(json.dumps({"joint": each.slot.name, LEAST: least, MOST: most}), flush=True)
    except BaseException as error:  # Ctrl-C and a closed pipe as well
        for each in fences[len(entries) :][:1]:
            entries += _as_it_is(client, place, each)
        why = _cut_short(options, place, calibration, fences, entries, folder)
        if isinstance(error, CallError):
            raise Rejected(f"{each.slot.name}: {error}. {why}") from error
        print(command_hint(options).prose(f"cut short: {why}"), file=sys.stderr, flush=True)
        raise
    next_steps(options, place, write_entries(place, calibration, entries, held=folder))
    return DONE


def _write(client: Client, each: ServoLimitChange) -> tuple[int, int]:
    """Write the differing limits; return both, as read back."""
    joint = each.slot.joint
    held = dict(zip((LEAST, MOST), each.held, strict=True))
    for name, value in each.writes:
        answer = client.call("WriteRegister", bus=joint.bus, id=joint.id, name=name, value=value)
        held[name] = int(answer["register"]["value"])
    return held[LEAST], held[MOST]


def _as_it_is(client: Client, place: CalibrationContext, each: ServoLimitChange) -> list[JointCalibration]:
    """Return the entry with the limits that the servo holds now; empty where it does not answer."""
    client.close()  # an answer of the call that was broken off may be under way
    try:
        device = records(client, place.robot, [each.slot]).get(each.slot.name)
    except (ClientError, Rejected):
        return []
    return [] if device is None else [each.entry_with((device.min_ticks, device.max_ticks))]


def _cut_short(
    options: argparse.Namespace,
    place: CalibrationContext,
    calibration: Calibration,
    fences: Sequence[ServoLimitChange],
    entries: Sequence[JointCalibration],
    folder: LockedFolder,
) -> str:
    """Record the known limits; return a text with the state and the command that continues."""
    if entries:
        write_entries(place, calibration, entries, held=folder)
    names = " ".join(each.slot.name for each in fences)
    return (
        f"{len(entries)} of {len(fences)} servos are recorded as they are; `twindctl calibrate limits {names}"
        f"{format_option(options)}` brings servos and file to agreement"
    )


def _print_line(options: argparse.Namespace, text: str) -> None:
    if not options.json:
        print(text, flush=True)
