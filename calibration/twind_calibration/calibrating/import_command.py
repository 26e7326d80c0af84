"""`twindctl calibrate import`: read the source and the servos, show the result, confirm, write. Blocks."""

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from twind.client import Client
from twind.command_line.verb import DONE, REFUSED, Rejected, UsageError, operator
from twind.config.calibrated_device import DeviceRecord
from twind.config.calibration_file import Calibration
from twind.config.yaml_tree import ConfigError, read_text
from twind.exceptions import InvalidInput
from twind.plain_file import read_plain
from twind_calibration.calibrating import calibration_draft as drafts
from twind_calibration.calibrating import lerobot_file
from twind_calibration.calibrating.calibration_actuators import CalibrationActuator, slots
from twind_calibration.calibrating.calibration_context import CalibrationContext, ground
from twind_calibration.calibrating.calibration_conversion import (
    Convention,
    ForeignCalibration,
    ImportResult,
    convert_entry,
    of_motor,
    of_registers,
)
from twind_calibration.calibrating.entry_writer import (
    agreed,
    next_steps,
    require_terminal,
    write_entries,
)
from twind_calibration.calibrating.motor_matching import matched, read_map
from twind_calibration.calibrating.recorded_devices import differences, of_file, records
from twind_calibration.rejection_hints import with_hints


@with_hints
def take(options: argparse.Namespace) -> int:
    """Return exit code 0 when the file has all requested actuators.

    Raises Rejected, UsageError, ClientError.
    """
    if (options.kind == "lerobot") != (options.file is not None):
        raise UsageError("--from lerobot takes a --file FILE, --from servo none")
    if options.map is not None and options.file is None:
        raise UsageError("--map goes with --from lerobot")
    require_terminal(options)
    with operator(options) as client:
        return _take(options, client)


def _take(options: argparse.Namespace, client: Client) -> int:
    place = ground(options, client)
    every = slots(place.robot)
    names = [slot.name for slot in every]
    motors = _motors(options, every)
    asked = place.select_actuators(options.joints, names)
    if motors is not None and options.joints and (absent := [name for name in asked if name not in motors]):
        raise Rejected(f"{options.file} says nothing of {', '.join(absent)}")
    chosen = [slot for slot in every if slot.name in asked and (motors is None or slot.name in motors)]
    zeros = _zeros(options, place, names)
    calibration = place.calibration()
    draft = drafts.load(place.path, place.robot)
    found = records(client, place.robot, chosen, of_file(calibration) | draft.devices)
    sources = {name: of_motor(motor, options.make) for name, motor in (motors or {}).items()}
    folded = [fold(slot, found, sources, draft, zeros, wide=options.wide) for slot in chosen]
    return _write(options, place, calibration, draft, folded)


def _motors(
    options: argparse.Namespace, every: Sequence[CalibrationActuator]
) -> dict[str, lerobot_file.LeRobotMotor] | None:
    """Read the motors of the LeRobot file, by actuator; None: no file given, the servos are read."""
    if options.file is None:
        return None
    try:
        motors = lerobot_file.read(read_plain(Path(options.file), lerobot_file.LARGEST), options.file)
        names = None if options.map is None else read_map(read_text(Path(options.map)), options.map)
    except OSError as error:
        raise Rejected(f"{options.file}: {error.strerror}") from None
    except (ConfigError, InvalidInput) as error:
        raise Rejected(str(error)) from None
    return matched(motors, every, names)


def _zeros(
    options: argparse.Namespace, place: CalibrationContext, names: Sequence[str]
) -> dict[str, Convention]:
    """Return the stated position of angle 0 of each actuator."""
    said: dict[str, Convention] = dict(options.zero_at)
    place.select_actuators([name for name in said if name], names)
    return {name: said.get(name, said.get("")) for name in names if name in said or "" in said}


def fold(
    slot: CalibrationActuator,
    found: Mapping[str, DeviceRecord],
    sources: Mapping[str, ForeignCalibration],
    draft: drafts.CalibrationDraft,
    zeros: Mapping[str, Convention],
    *,
    wide: bool,
) -> ImportResult:
    """Calibration entry of one actuator from foreign values and the sweep of the draft."""
    device = found.get(slot.name)
    swept = draft.swept.get(slot.name)
    if device is None:
        return ImportResult(slot, None, ("no device answers there",))
    if slot.name not in zeros:
        return ImportResult(
            slot, None, (f"the count at its angle 0 is not given: --zero-at {slot.name}=TICKS",)
        )
    source = sources.get(slot.name)
    note = ""
    if source is None:
        changed = [] if swept is None else differences(swept.device, device)
        source = of_registers(slot, device, None if swept is None or changed else swept.sweep_ticks)
        note = _limits(source, changed)
    return replace(convert_entry(slot, source, device, zeros[slot.name], wide=wide), note=note)


def _limits(source: ForeignCalibration, changed: Sequence[str]) -> str:
    """Return the note about a travel that was not swept."""
    if source.swept:
        return ""
    without = f"; not what was swept, its servo is not as it was then: {', '.join(changed)}"
    return f"the travel is its position limits{without if changed else ''}"


def _write(
    options: argparse.Namespace,
    place: CalibrationContext,
    calibration: Calibration | None,
    draft: drafts.CalibrationDraft,
    imported: Sequence[ImportResult],
) -> int:
    """Show, confirm, write, print the next step; return the exit code."""
    width = max((len(each.slot.name) for each in imported), default=0)
    for each in imported:
        print(json.dumps(_to_json(each)) if options.json else _line(each, width), flush=True)
    entries = [each.entry for each in imported if each.entry is not None]
    if not entries:
        raise Rejected("nothing can be taken: nothing was written")
    if not agreed(options, f"write {len(entries)} of {len(imported)} joints to {place.path}?"):
        raise Rejected("nothing was written")
    drafts.require_room(place.path)
    after = write_entries(place, calibration, entries, "import")
    whole = [each.name for each in entries]
    drafts.change(place.path, place.robot, lambda known: known.after(draft, whole))
    next_steps(options, place, after)
    return DONE if len(entries) == len(imported) else REFUSED


def _line(imported: ImportResult, width: int) -> str:
    one = imported.entry
    note = f"; {imported.note}" if imported.note else ""
    if one is None:
        return f"NOT  {imported.slot.name}: {'; '.join(imported.wrong)}{note}"
    low, high = one.sweep_ticks
    offset = one.device.homing_offset_ticks
    kept = f", homing offset {offset} kept" if offset else ""
    return f"ok   {one.name:<{width}} zero at {one.zero_ticks:>6}, travel {low}..{high}{kept}{note}"


def _to_json(imported: ImportResult) -> dict[str, object]:
    one = imported.entry
    return {
        "joint": imported.slot.name,
        "good": one is not None,
        "wrong": list(imported.wrong),
        "note": imported.note,
        "zero_ticks": None if one is None else one.zero_ticks,
        "sweep_ticks": None if one is None else list(one.sweep_ticks),
        "homing_offset_ticks": None if one is None else one.device.homing_offset_ticks,
    }
