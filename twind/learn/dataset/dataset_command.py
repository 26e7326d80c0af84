"""Convert recordings to a LeRobotDataset.

LeRobot writes it: run this in the environment of LeRobot, with the package lerobot_robot_twind. Reads .mcap
and .flight files. Episodes are those marked (`twindctl mark begin TASK`, `mark end --success`); a recording
without marks gives one episode for each stretch without a hole. Unusable parts are left out and reported:
missing readings, unknown or silent joints, times without goals. No hole is filled. No file is
overwritten.
"""

import argparse
from importlib.util import find_spec
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

from twind.command_line.extras import clone
from twind.command_line.progress import ProgressLine
from twind.command_line.verb import DONE, Rejected, UsageError, show

if TYPE_CHECKING:
    from twind.learn.dataset.episode_collection import DatasetContents

PLUGIN = "lerobot_robot_twind"
group = "learn"
unused_options = ("--socket",)  # it asks no daemon


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
    if find_spec(PLUGIN) is None:
        raise UsageError(f"dataset needs LeRobot with the package {PLUGIN}: {_how_to_install()}")
    if options.fps < 1:
        raise UsageError(f"--fps {options.fps}: at least 1")
    if not (isfinite(options.gap) and options.gap > 0.0):
        raise UsageError(f"--gap {options.gap:g}: above 0")
    from lerobot_robot_twind.dataset_writer import write

    from twind.learn.dataset.episode_collection import DatasetRequest, gather
    from twind.learn.dataset.new_folder import whole_folder

    asked = DatasetRequest(options.fps, options.task, options.only_success, options.robot_type, options.gap)
    with ProgressLine(options, "dataset") as progress:
        try:
            with whole_folder(options.out) as folder:
                gathered = gather(options.files, asked, lambda path: progress.update(path.name))
                progress.update(f"writing {gathered.frames} frames")
                write(gathered, folder)
        except OSError as error:
            raise Rejected(f"{error.filename or options.out}: {error.strerror or error}") from None
    return _print_summary(options, gathered)


def _how_to_install() -> str:
    source = clone() or Path("CLONE")
    return f"in LeRobot's environment, python -m pip install {source} {source / 'integrations/lerobot'}"


def _print_summary(options: argparse.Namespace, gathered: "DatasetContents") -> int:
    from twind.learn.dataset.episode_collection import line

    data = {
        "out": str(options.out),
        "episodes": len(gathered.episodes),
        "frames": gathered.frames,
        "fps": gathered.fps,
        "tasks": list(gathered.tasks),
        "features": list(gathered.features),
        "sources": [
            {"recording": each.recording, "time": each.time, "frames": each.count, "success": each.success}
            for each in gathered.episodes
        ],
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
    lines.append(f"not in it: {', '.join(gathered.absent)}; nor what was asked for before the gate")
    show(options, data, "\n".join(lines))
    return DONE
