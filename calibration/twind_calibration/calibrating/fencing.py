"""`twindctl calibrate limits`: registers of servos and the record of them, written together. Blocks."""

import argparse
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from twind.client import CallError, Client
from twind.config.calibration_file import Calibration, DeviceRecord, JointCalibration
from twind.ctl.verb import DONE, REFUSED, Rejected, operator
from twind_calibration.again import again
from twind_calibration.calibrating.devices import differences, records
from twind_calibration.calibrating.ground import Ground, ground
from twind_calibration.calibrating.limp import limp, require_limp
from twind_calibration.calibrating.placing import fence
from twind_calibration.calibrating.slots import Slot, slots
from twind_calibration.calibrating.writing import agreed, next_steps, require_somebody, written
from twind_drivers.clock import MonotonicClock

LEAST, MOST = "min_position_limit", "max_position_limit"


@dataclass(frozen=True, slots=True)
class Fence:
    """What one servo's limits are, and what they are to be."""

    slot: Slot
    entry: JointCalibration
    wanted: tuple[int, int]

    @property
    def now(self) -> tuple[int, int]:
        """As recorded, which is what the servo holds."""
        return self.entry.device.min_ticks, self.entry.device.max_ticks

    @property
    def writes(self) -> list[tuple[str, int]]:
        """In an order in which the lower limit never passes the upper one."""
        low, high = (LEAST, self.wanted[0]), (MOST, self.wanted[1])
        return [high, low] if self.wanted[0] > self.now[0] else [low, high]

    def line(self, width: int) -> str:
        """For a person."""
        then, now = (f"{first}..{last}" for first, last in (self.now, self.wanted))
        radians = f"{self.slot.lower:g}..{self.slot.upper:g} rad"
        return f"{self.slot.name:<{width}} {then:>12} -> {now:<12} {radians}"


def limits(options: argparse.Namespace) -> int:
    """Exit code 0: done, or nothing to do. Raises Rejected, UsageError, ClientError."""
    try:
        require_somebody(options)
        with operator(options) as client:
            return _limits(options, client)
    except Rejected as error:  # what it says to type is typed for the same daemon
        raise Rejected(again(options).prose(str(error))) from error


def _limits(options: argparse.Namespace, client: Client) -> int:
    place, clock = ground(options, client), MonotonicClock()
    if client.call("GetStatus")["status"]["mode"] != "live":
        raise Rejected("registers are written in mode live alone: `twindctl mode live`, then again")
    calibration = place.calibration()
    if calibration is None:
        raise Rejected(f"{place.path} is not there: `twindctl calibrate sweep`, then `zero`, first")
    fences = _fences(options, place, calibration)
    width = max((len(each.slot.name) for each in fences), default=0)
    if not fences:
        _say(options, "every servo has the limits of its joint, or a mode that knows none")
        return DONE
    require_limp(client, clock)
    found = records(client, place.robot, [each.slot for each in fences])
    for each in fences:
        _require_same(each, found)
    for each in fences:
        _say(options, each.line(width))
    if not agreed(options, f"write these limits to {len(fences)} servos?"):
        raise Rejected("nothing was written")
    with limp(client, clock, take=options.take) as keep:
        return _carry_out(options, client, place, calibration, fences, keep)


def _fences(options: argparse.Namespace, place: Ground, calibration: Calibration) -> list[Fence]:
    """Those that differ. Raises Rejected: one that was named is not calibrated."""
    every = slots(place.robot)
    names = place.chosen(options.joints, [slot.name for slot in every])
    missing = [name for name in names if name not in calibration.by_name]
    if options.joints and missing:
        raise Rejected(
            f"not calibrated: {', '.join(missing)}: `twindctl calibrate sweep`, then `zero`, first"
        )
    found = []
    for slot in every:
        entry = calibration.by_name.get(slot.name)
        if entry is None or slot.name not in names:
            continue
        wanted = fence(slot, entry.zero_ticks, entry.device)
        if wanted is not None and wanted != (entry.device.min_ticks, entry.device.max_ticks):
            found.append(Fence(slot, entry, wanted))
    return found


def _require_same(each: Fence, found: Mapping[str, DeviceRecord]) -> None:
    """Raises Rejected: the servo is not as its calibration has it."""
    device = found.get(each.slot.name)
    changed = ["nobody answers there"] if device is None else differences(each.entry.device, device)
    if changed:
        raise Rejected(
            f"{each.slot.name} is not as it was calibrated: {', '.join(changed)}: put that right first, or "
            "calibrate it anew"
        )


def _carry_out(
    options: argparse.Namespace,
    client: Client,
    place: Ground,
    calibration: Calibration,
    fences: Sequence[Fence],
    keep: Callable[[], None],
) -> int:
    """Each servo whole, then the file; what was written is recorded whatever ends it."""
    entries: list[JointCalibration] = []
    failed = ""
    try:
        for each in fences:
            keep()
            try:
                low, high = _write(client, each)
            except CallError as error:
                failed = f"{each.slot.name}: {error}"
                entries += _as_it_is(client, place, each)
                break
            device = replace(each.entry.device, min_ticks=low, max_ticks=high)
            entries.append(replace(each.entry, device=device))
            told = {"joint": each.slot.name, LEAST: low, MOST: high}
            if options.json:
                print(json.dumps(told), flush=True)
    finally:
        if entries:
            after = written(place, calibration, entries)
    if failed:
        raise Rejected(
            f"{failed}; {len(entries)} of {len(fences)} servos were written, and recorded as they are"
        )
    next_steps(options, place, after)
    return DONE if len(entries) == len(fences) else REFUSED


def _write(client: Client, each: Fence) -> tuple[int, int]:
    """Both registers, as they read back."""
    joint, found = each.slot.joint, {LEAST: each.now[0], MOST: each.now[1]}
    for name, value in each.writes:
        answer = client.call("WriteRegister", bus=joint.bus, id=joint.id, name=name, value=value)
        found[name] = int(answer["register"]["value"])
    return found[LEAST], found[MOST]


def _as_it_is(client: Client, place: Ground, each: Fence) -> list[JointCalibration]:
    """The entry with what the servo holds now; none where it does not tell."""
    try:
        device = records(client, place.robot, [each.slot]).get(each.slot.name)
    except (CallError, Rejected):
        return []
    return [] if device is None else [replace(each.entry, device=device)]


def _say(options: argparse.Namespace, text: str) -> None:
    if not options.json:
        print(text, flush=True)
