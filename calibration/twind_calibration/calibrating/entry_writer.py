"""Writing of new calibration entries: checked as by the daemon, confirmed, saved, reported."""

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
from twind.ctl.hint_options import command_hint
from twind.ctl.instance_paths import restart
from twind.exceptions import InvalidInput
from twind.twin.binding import bind
from twind_calibration.calibrating import file_ownership
from twind_calibration.calibrating.calibration_actuators import slots
from twind_calibration.calibrating.calibration_context import TOOL, CalibrationContext, now


def require_terminal(options: argparse.Namespace) -> None:
    """Raises UsageError without a terminal for a question, before any measurement."""
    if options.yes:
        return
    if options.json:
        raise UsageError("--json asks no question: add --yes")
    if not sys.stdin.isatty():
        raise UsageError("cannot ask: standard input is no terminal; add --yes")


def agreed(options: argparse.Namespace, question: str) -> bool:
    """Return the consent to a question; True with `--yes`."""
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
    """Merge entries that were made from the file `before` into the present file; return the result.

    `held`: its folder, if already locked. Raises Rejected: another program replaced one of them since, or the
    daemon would refuse the file.
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
    """Return the present file. Raises Rejected: entries of `names` differ from `before`."""
    now = place.calibration()
    then, there = ({} if each is None else each.by_name for each in (before, now))
    other = [name for name in names if then.get(name) != there.get(name)]
    if other:
        raise Rejected(
            f"another program calibrated {', '.join(other)} meanwhile: {place.path} has changed, and "
            "nothing was written. Run the command again: it uses the present file"
        )
    return now


def next_steps(options: argparse.Namespace, place: CalibrationContext, after: Calibration) -> None:
    """Print the joints still open, and the command that makes the daemon use the file."""
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
