"""Convert recordings to a data set for imitation learning (LeRobotDataset v3.0).

Reads .mcap and .flight files. Episodes are those marked (`twindctl mark begin TASK`, `mark end --success`);
a recording without marks gives one episode for each stretch without a hole. Unusable parts are left out and
reported: missing readings, unknown or silent joints, times without goals. Nothing is interpolated. No file
is overwritten.
"""

import argparse
from importlib.util import find_spec
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

from twind.command_line.extras import how_to_add
from twind.command_line.progress import ProgressLine
from twind.command_line.verb import DONE, Rejected, UsageError, show

if TYPE_CHECKING:
    from twind.learn.dataset.episode_collection import DatasetContents

group = "learn"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `twindctl dataset`."""
    parser.add_argument("files", metavar="RECORDING", type=Path, nargs="+", help="an .mcap or .flight file")
    parser.add_argument("--out", metavar="DIR", type=Path, required=True, help="the folder to make")
    parser.add_argument("--fps", type=int, default=50, metavar="N", help="frames a second (default: 50)")
    parser.add_argument("--task", metavar="T", help="the task of episodes that have none")
    parser.add_argument("--only-success", action="store_true", help="only episodes marked as a success")
    parser.add_argument("--robot-type", metavar="NAME", help="in place of the robot's name in the recording")
    parser.add_argument(
        "--gap",
        type=float,
        default=0.1,
        metavar="S",
        help="a longer time without a reading is a hole (default: 0.1, where the robot itself holds)",
    )


def run(options: argparse.Namespace) -> int:
    """Exit code 0: it is written. Raises UsageError, Rejected."""
    if find_spec("pyarrow") is None:
        raise UsageError(f"dataset needs pyarrow: {how_to_add('dataset')}")
    if options.fps < 1:
        raise UsageError(f"--fps {options.fps}: at least 1")
    if not (isfinite(options.gap) and options.gap > 0.0):
        raise UsageError(f"--gap {options.gap:g}: above 0")
    from twind.learn.dataset.dataset_folder import spare, write
    from twind.learn.dataset.episode_collection import DatasetRequest, gather

    asked = DatasetRequest(options.fps, options.task, options.only_success, options.robot_type, options.gap)
    with ProgressLine(options, "dataset") as progress:
        try:
            spare(options.out)
            gathered = gather(options.files, asked, lambda path: progress.update(path.name))
            progress.update(f"writing {gathered.frames} frames")
            write(gathered, options.out)
        except OSError as error:
            raise Rejected(f"{error.filename or options.out}: {error.strerror or error}") from None
    return _print_summary(options, gathered)


def _print_summary(options: argparse.Namespace, gathered: "DatasetContents") -> int:
    from twind.learn.dataset.dataset_folder import absent
    from twind.learn.dataset.episode_collection import line

    data = {
        "out": str(options.out),
        "episodes": len(gathered.episodes),
        "frames": gathered.frames,
        "fps": gathered.fps,
        "tasks": list(gathered.tasks),
        "features": list(gathered.features),
        "left_out": [
            {"recording": each.recording, "task": each.task, "time": each.time, "why": each.why}
            for each in gathered.left
        ],
        "damage": list(gathered.damage),
    }
    lines = [
        f"{options.out}: {len(gathered.episodes)} episodes of {', '.join(gathered.tasks)}; "
        f"{gathered.frames} frames of {len(gathered.joints)} joints, {gathered.frames / gathered.fps:.1f} s"
    ]
    lines += [f"left out: {line(each)}" for each in gathered.left]
    lines += [f"damaged: {each}" for each in gathered.damage]
    lines.append(f"not in it: {', '.join(absent(gathered))}; nor what was asked for before the gate")
    show(options, data, "\n".join(lines))
    return DONE
