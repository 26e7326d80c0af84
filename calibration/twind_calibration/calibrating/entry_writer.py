"""New entries into the calibration file: checked as the daemon would, asked for, written, told."""

import argparse
import contextlib
import json
import sys
from collections.abc import Sequence

from twind.command_line.verb import Rejected, UsageError
from twind.config.atomic_save import LockedFolder
from twind.config.calibration_file import (
    Calibration,
    JointCalibration,
    dump_calibration,
    read_calibration,
)
from twind.config.yaml_tree import ConfigError
from twind.ctl.command_hint import command_hint
from twind.ctl.instance_paths import restart
from twind.exceptions import InvalidInput
from twind.twin.binding import bind
from twind_calibration.calibrating import file_ownership
from twind_calibration.calibrating.calibration_actuators import slots
from twind_calibration.calibrating.calibration_context import TOOL, CalibrationContext, now


def require_somebody(options: argparse.Namespace) -> None:
    """Raises UsageError where a question could not be answered, before anything is measured."""
    if options.yes:
        return
    if options.json:
        raise UsageError("--json asks nobody: add --yes")
    if not sys.stdin.isatty():
        raise UsageError("nobody to ask: standard input is no terminal; add --yes")


def agreed(options: argparse.Namespace, question: str) -> bool:
    """Whether a person, or `--yes`, says so."""
    if options.yes:
        return True
    print(f"{question} [y/N] ", end="", flush=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def merged(
    place: CalibrationContext,
    before: Calibration | None,
    entries: Sequence[JointCalibration],
    method: str = "jig",
) -> Calibration:
    """The file with these entries in place of the earlier ones, in the robot's order."""
    fresh = {each.name: each for each in entries}
    known = {} if before is None else dict(before.by_name)
    order = [slot.name for slot in slots(place.robot) if slot.name in fresh or slot.name in known]
    return Calibration(
        robot=place.robot.name,
        robot_description_sha256=place.robot.description_sha256,
        created=now(),
        tool=TOOL,
        method_default=method if before is None else before.method_default,
        joints=tuple(fresh.get(name) or known[name] for name in order),
    )


def write_entries(
    place: CalibrationContext,
    before: Calibration | None,
    entries: Sequence[JointCalibration],
    method: str = "jig",
    held: LockedFolder | None = None,
) -> Calibration:
    """Put these entries, made when the file was `before`, into what it is by now; what it holds then.

    `held`: its folder, where that is held already (`kept.alone`). Raises Rejected: somebody else replaced one
    of them since, or the daemon would refuse the file.
    """
    with (
        contextlib.nullcontext(held) if held is not None else file_ownership.lock_folder(place.path) as folder
    ):
        now = unchanged(place, before, [each.name for each in entries])
        after = merged(place, now, entries, method)
        try:
            text = dump_calibration(after)
            after = read_calibration(text, str(place.path), place.robot)
            bind(place.robot, after)
        except (ConfigError, InvalidInput) as error:
            raise Rejected(
                f"the daemon would refuse this calibration, nothing was written: {error}"
            ) from None
        file_ownership.save(after, place.path, folder)
    return after


def unchanged(
    place: CalibrationContext, before: Calibration | None, names: Sequence[str]
) -> Calibration | None:
    """What the file says by now; the same of `names` as `before`. Raises Rejected: another thing."""
    now = place.calibration()
    then, there = ({} if each is None else each.by_name for each in (before, now))
    other = [name for name in names if then.get(name) != there.get(name)]
    if other:
        raise Rejected(
            f"somebody else calibrated {', '.join(other)} meanwhile: {place.path} is another by now, and "
            "nothing was written. The same once more goes by what it says now"
        )
    return now


def next_steps(options: argparse.Namespace, place: CalibrationContext, after: Calibration) -> None:
    """Say what is still to be done, and the command that brings the file into force."""
    names = [slot.name for slot in slots(place.robot)]
    left = [name for name in names if name not in after.by_name]
    start = restart(options.socket)
    if options.json:
        print(json.dumps({"written": str(place.path), "left": left, "next": start}), flush=True)
        return
    tell = command_hint(options).prose
    print(f"written: {place.path}, {len(after.joints)} of {len(names)} joints")
    if left:
        print(tell(f"not calibrated yet: {', '.join(left)}: `twindctl calibrate sweep` goes on with them"))
    where = "" if not options.calibration else f" with --calibration {place.path}"
    print(f"it is in force when the daemon starts again{where}: `{start}`, or Ctrl-C where it runs and again")
