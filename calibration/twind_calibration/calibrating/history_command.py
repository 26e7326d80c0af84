"""`twindctl calibrate show`, `diff` and `rollback`."""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import groupby
from math import degrees
from typing import Any

from twind.client import NoDaemon
from twind.command_line.text_table import align_columns
from twind.command_line.verb import DONE, Rejected, observer, show
from twind.config.calibration_file import Calibration, JointCalibration
from twind.ctl.hint_options import command_hint
from twind.exceptions import InvalidInput
from twind.twin.binding import bind
from twind_calibration.calibrating import file_ownership
from twind_calibration.calibrating.calibration_actuators import CalibrationActuator, slots
from twind_calibration.calibrating.calibration_archive import CURRENT, CalibrationArchive
from twind_calibration.calibrating.calibration_context import CalibrationContext, ground
from twind_calibration.calibrating.calibration_diff import CalibrationChange, changes
from twind_calibration.calibrating.entry_writer import agreed, next_steps, require_terminal
from twind_calibration.calibrating.recorded_devices import FENCE
from twind_calibration.calibrating.zero_placement import spread
from twind_calibration.rejection_hints import with_hints
from twind_calibration.robot_description import read

HEADS = ("joint", "bus", "id", "zero", "±", "sign", "travel", "deg", "seam", "offset", "method", "proved")


def _place(options: argparse.Namespace) -> CalibrationContext:
    """Locate the calibration files: by the running daemon, unless options name them; else by the settings."""
    named = options.robot or options.config or options.port
    if not named:
        try:
            with observer(options) as client:
                return ground(options, client)
        except NoDaemon:
            pass  # a file that it cannot use may be why
    described = read(options)
    if described.calibration is None:
        raise Rejected(f"{described.robot.name} has no calibration file yet; --calibration FILE names one")
    return CalibrationContext(described.robot, described.calibration.absolute(), named=True)


def _archive(place: CalibrationContext) -> CalibrationArchive:
    return CalibrationArchive(place.path, place.robot)


# ------------------------------------------------------------------------------------------- show


@with_hints
def show_file(options: argparse.Namespace) -> int:
    """Print the calibration file, or an earlier one."""
    place = _place(options)
    archive = _archive(place)
    one = archive.read(options.which)
    file = archive.file(options.which)
    earlier = archive.numbers()
    data = {"file": str(file), **asdict(one), "earlier": list(earlier)}
    show(options, data, "\n".join(_page(one, str(file), earlier, slots(place.robot))))
    return DONE


def _page(
    one: Calibration, file: str, earlier: Sequence[int], every: Sequence[CalibrationActuator]
) -> list[str]:
    rows: list[Sequence[str]] = [HEADS]
    rows += [_row(slot, one.by_name[slot.name]) for slot in every if slot.name in one.by_name]
    left = [slot.name for slot in every if slot.name not in one.by_name]
    lines = [f"{file}: {one.robot}, {one.created}, by {one.tool}", *align_columns(rows, left=(0, 1, 10, 11))]
    lines += [f"not calibrated: {', '.join(left)}"] if left else []
    numbers = ", ".join(f"{number:04d}" for number in earlier) or "none"
    return [*lines, f"earlier files: {numbers}"]


def _row(slot: CalibrationActuator, one: JointCalibration) -> Sequence[str]:
    low, high = one.sweep_ticks
    return (
        *(one.name, one.bus, str(one.id), str(one.zero_ticks), _format_spread(one)),
        *(f"{one.sign:+d}", f"{low}..{high}", f"{degrees((high - low) * abs(slot.rad_per_tick)):.1f}"),
        *(str(one.seam_margin_ticks), str(one.device.homing_offset_ticks), one.method, _proved(one.proof)),
    )


def _format_spread(one: JointCalibration) -> str:
    known = spread(one)
    return "?" if known is None else f"{known:.1f}"


def _proved(proof: Any) -> str:
    if proof is None:
        return "no"
    return str(proof.get("sign", "yes")) if isinstance(proof, Mapping) else str(proof)


# ------------------------------------------------------------------------------------------- diff


@with_hints
def diff(options: argparse.Namespace) -> int:
    """Print the differences between two calibration files."""
    place = _place(options)
    archive = _archive(place)
    before = options.before or _latest(archive)
    found = changes(archive.read(before), archive.read(options.after), slots(place.robot))
    told = [
        {"joint": each.name, "what": each.what, "before": each.before, "after": each.after}
        | ({} if each.degrees is None else {"degrees": round(each.degrees, 4)})
        for each in found
    ]
    data = {"before": str(archive.file(before)), "after": str(archive.file(options.after)), "changes": told}
    lines = [f"{data['before']} -> {data['after']}", *_lines(found)]
    show(options, data, "\n".join(lines))
    return DONE


def _latest(archive: CalibrationArchive) -> str:
    numbers = archive.numbers()
    if not numbers:
        raise Rejected(f"{archive.path} has no earlier file to compare with")
    return str(numbers[-1])


def _lines(found: Sequence[CalibrationChange]) -> list[str]:
    lines = []
    for name, own in groupby(found, key=lambda each: each.name):
        lines += [f"{name}:", *(f"  {each}" for each in own)]
    return lines or ["nothing differs"]


# ------------------------------------------------------------------------------------------- rollback


@with_hints
def rollback(options: argparse.Namespace) -> int:
    """Restore an earlier file; the file that it replaces becomes the latest earlier one."""
    require_terminal(options)
    place = _place(options)
    archive = _archive(place)
    earlier = archive.read(options.which)
    file = archive.file(options.which)
    try:
        bind(place.robot, earlier)
    except InvalidInput as error:
        raise Rejected(f"the daemon would refuse {file}: {error}") from None
    shown = _bytes(place)
    if not options.json:
        print("\n".join([f"{place.path} -> {file}", *_against_now(archive, earlier, place)]), flush=True)
    if not agreed(options, f"put {file.name} of {earlier.created} back?"):
        raise Rejected("nothing was written")
    with file_ownership.lock_folder(place.path) as folder:
        if _bytes(place) != shown:
            raise Rejected(
                f"another program wrote {place.path} meanwhile, and nothing was written now: run "
                "the command again to see its contents"
            )
        fenced = _fenced_since(archive, earlier)
        file_ownership.save(earlier, place.path, folder)
    next_steps(options, place, earlier)
    if fenced and not options.json:
        command = command_hint(options).prose(f"`twindctl calibrate limits {' '.join(fenced)}`")
        print(
            f"the servos' own position limits were others then: {', '.join(fenced)}. Arming is refused until "
            f"they are those of the file: restart the daemon, {command}, and restart it again"
        )
    return DONE


def _bytes(place: CalibrationContext) -> bytes:
    """Return the raw content of the file in force, valid or not; empty where it is unreadable."""
    try:
        return place.path.read_bytes()
    except OSError:
        return b""


def _fenced_since(archive: CalibrationArchive, earlier: Calibration) -> list[str]:
    """Return the joints whose recorded position limits differ between `earlier` and the file in force.

    `twindctl calibrate limits` corrects them. Empty where the file in force is unusable.
    """
    try:
        now = archive.read(CURRENT).by_name
    except Rejected:
        return []
    return [
        each.name
        for each in earlier.joints
        if (one := now.get(each.name)) is not None
        and any(getattr(each.device, name) != getattr(one.device, name) for name in FENCE)
    ]


def _against_now(archive: CalibrationArchive, earlier: Calibration, place: CalibrationContext) -> list[str]:
    """Return the differences from the file in force; an unreadable file in force is no obstacle."""
    try:
        return _lines(changes(archive.read(CURRENT), earlier, slots(place.robot)))
    except Rejected as error:
        return [f"what it holds now cannot be used: {error}"]
