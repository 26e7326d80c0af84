"""Train a policy in simulation.

TASK is `stand` (balance on soft servos) or `humanoid` (walk as commanded). PPO of Stable-Baselines3 learns
on a batch of simulations. At intervals it is evaluated on separate simulations, beside the zero policy,
which only holds the default pose. Ctrl-C ends it with a checkpoint; --resume continues, also after a kill.

In the folder: policy.onnx (the best so far: `twindctl policy run`), last.onnx, curve.png, run.json
(settings, versions, figures), checkpoint.pt.
"""

import argparse
import contextlib
import sys
from datetime import datetime
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from twind.command_line.extras import how_to_add
from twind.command_line.verb import DONE, Rejected, UsageError
from twind.exceptions import InvalidInput, OperationFailed
from twind.learn.training.training_settings import DEFAULTS, KINDS

group = "learn"

NEEDED = ("torch", "stable_baselines3", "gymnasium", "onnx", "onnxruntime", "matplotlib", "mink")
# Options that settings are made of: flag, type, metavar, help; the field is the flag's name.
FIGURES: tuple[tuple[str, Any, str, str], ...] = (
    (
        "steps",
        int,
        "N",
        "control steps of all environments together, rounded up to whole updates; the learning rate falls "
        "with the share of them that is done, so the same step of a longer training is another policy",
    ),
    ("envs", int, "N", "simulations at a time"),
    ("seed", int, "N", "of everything that is drawn"),
    ("evaluate_every", int, "N", "steps between two evaluations, each with a checkpoint"),
    ("episodes", int, "N", "of each evaluation"),
    ("rollout", int, "N", "steps of each simulation between two updates"),
    ("batch", int, "N", "steps in one gradient step"),
    ("epochs", int, "N", "times that a rollout is learnt from"),
    ("learning_rate", float, "X", "at the beginning; it falls to a twentieth over --steps"),
    ("gamma", float, "X", "what a reward one step later is worth"),
    ("std", float, "X", "of the actions that are tried, at the beginning; 1: the whole reach"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `twindctl train`."""
    parser.add_argument(
        "task", metavar="TASK", nargs="?", help="stand, walk or humanoid; with --resume not needed"
    )
    parser.add_argument("--robot", metavar="NAME|FILE", help="robot file (default: h24)")
    parser.add_argument(
        "--profile",
        metavar="NAME|FILE",
        help="ranges of randomisation: none, default, or a file",
    )
    parser.add_argument(
        "--randomise",
        choices=("identified",),
        help="draw from the uncertainties of the identified model; --profile (then: default) has the ranges "
        "of all else",
    )
    parser.add_argument(
        "--identified",
        metavar="FILE",
        help="this identified model, and --randomise identified (default: beside the robot's calibration)",
    )
    parser.add_argument("--kind", choices=KINDS, help="how simulations run (default: batch, the fastest)")
    for name, kind, metavar, text in FIGURES:
        parser.add_argument(
            f"--{name.replace('_', '-')}", type=kind, metavar=metavar, help=text + _default(name)
        )
    sizes = f"hidden layers of actor and critic{_default('hidden')}"
    parser.add_argument("--hidden", type=_sizes, metavar="N,N", help=sizes)
    parser.add_argument(
        "--tensorboard-log", type=Path, metavar="DIR", help="logs for TensorBoard, as SB3 writes them"
    )
    parser.add_argument(
        "--ray",
        metavar="ADDRESS",
        help="workers of the Ray cluster at HOST:PORT, auto (the one of this machine) or local (a new one of "
        "processes here) share the simulations; --out is then best on a disk that the machines share",
    )
    parser.add_argument(
        "--ray-workers", type=_count, metavar="N", help="how many (default: one for each core of the cluster)"
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--out", type=Path, metavar="DIR", help="folder to make (default: TASK-DATE-TIME here)"
    )
    where.add_argument("--resume", type=Path, metavar="DIR", help="go on with the training in DIR")


def _default(name: str) -> str:
    """Return the default of a setting as help text, with the tasks where it differs."""
    usual = getattr(DEFAULTS["Stand"], name)
    others = {task.lower(): getattr(each, name) for task, each in DEFAULTS.items()}
    defaults = [
        _figure(usual),
        *(f"{task}: {_figure(each)}" for task, each in others.items() if each != usual),
    ]
    return f" (default: {'; '.join(defaults)})"


def _figure(value: Any) -> str:
    return ",".join(map(str, value)) if isinstance(value, tuple) else str(value)


def _sizes(text: str) -> tuple[int, ...]:
    """`256,256` as numbers. Raises ArgumentTypeError."""
    try:
        sizes = tuple(int(each) for each in text.split(","))
    except ValueError:
        sizes = ()
    if not sizes or not all(1 <= each <= 4096 for each in sizes):
        raise argparse.ArgumentTypeError(f"{text!r}: sizes of 1 to 4096 are needed, as in 256,256")
    return sizes


def _count(text: str) -> int:
    """A number of 1 or more. Raises ArgumentTypeError."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r}: at least 1 is needed")
    return int(text)


def run(options: argparse.Namespace) -> int:
    """Exit code 0: trained, or stopped with a checkpoint. Raises UsageError, Rejected."""
    missing = [name for name in NEEDED if find_spec(name) is None]
    if missing:
        raise UsageError(f"train needs {', '.join(missing)}: {how_to_add('learn')}")
    if options.tensorboard_log is not None and find_spec("tensorboard") is None:
        raise UsageError(f"--tensorboard-log needs tensorboard: {how_to_add('tensorboard')}")
    if options.ray is not None and find_spec("ray") is None:
        raise UsageError(f"--ray needs ray: {how_to_add('ray')}")
    if options.ray_workers is not None and options.ray is None:
        raise UsageError("--ray-workers: name a cluster with --ray")
    from twind.config.yaml_tree import ConfigError
    from twind.learn.training.training_folder import lock_folder, require_fresh

    given = _given(options)
    if options.resume is None and options.task is None:
        raise UsageError("name a TASK, stand, walk or humanoid, or a folder with --resume")
    try:
        if options.resume is not None:
            if not options.resume.is_dir():
                raise Rejected(f"{options.resume}: there is no such folder")
            with lock_folder(options.resume) as folder:
                return _resumed(options, given, folder)
        settings = _settings(given)
        out = options.out or Path(f"{settings.task.lower()}-{datetime.now():%Y%m%d-%H%M%S}")
        require_fresh(out)
        with lock_folder(out) as folder:
            require_fresh(out)
            return _trained(options, settings, folder, None)
    except (ConfigError, InvalidInput) as error:
        raise Rejected(str(error)) from None


def _given(options: argparse.Namespace) -> dict[str, object]:
    """Return the settings that the options name, and no others. Raises UsageError: no such task."""
    from twind.learn.task.learning_tasks import task_of

    names = ("robot", "profile", "kind", "hidden", *(name for name, *_ in FIGURES))
    given = {name: getattr(options, name) for name in names if getattr(options, name) is not None}
    if options.task is not None:
        try:
            given["task"] = task_of(options.task).name
        except KeyError as error:
            raise UsageError(error.args[0]) from None
    if options.identified is not None or options.randomise is not None:
        given["identified"] = str(_identified(options).absolute())
    return given


def _identified(options: argparse.Namespace) -> Path:
    """Return the identified model that is named, else that beside the calibration. Raises Rejected."""
    from twind.config.config_files import overlay_path
    from twind.config.daemon_settings import load_settings
    from twind.config.robot_file import load_robot
    from twind.config.yaml_tree import ConfigError

    try:
        robot = load_robot(options.robot or DEFAULTS["Stand"].robot).name
        path = overlay_path(load_settings(None), robot, options.identified)
    except (ConfigError, InvalidInput) as error:
        raise Rejected(str(error)) from None
    if not path.is_file():
        raise Rejected(
            f"{path}: no identified model: run `twindctl identify`, or name one by --identified FILE"
        )
    return path


def _settings(given: dict[str, Any]) -> Any:
    from twind.learn.training.training_settings import make_settings, originated

    try:
        settings = make_settings(given["task"], given)
    except ValueError as error:
        raise UsageError(str(error)) from None
    return originated(settings)


def _resumed(options: argparse.Namespace, given: dict[str, Any], folder: Any) -> int:
    """Raises Rejected: other settings than before, another robot or other ranges."""
    from dataclasses import replace

    from twind.learn.training.training_folder import read_run
    from twind.learn.training.training_settings import describe_changes, differences

    settings, before = read_run(folder.path)
    wrong = differences(settings, given) + describe_changes(settings)
    if wrong:
        raise Rejected(
            f"{folder.path}: it was begun otherwise: {'; '.join(wrong)}; leave that out, or train anew"
        )
    return _trained(options, replace(settings, steps=given.get("steps", settings.steps)), folder, before)


def _trained(options: argparse.Namespace, settings: Any, folder: Any, before: Any) -> int:
    from twind.learn.training.training_reporter import TrainingReporter

    reporter = TrainingReporter(options, sys.stdout)
    if options.ray is None:
        return _run_trainer(options, settings, folder, before, reporter)
    from twind.learn.training.ray_cluster import ray_workers
    from twind.learn.training.training_folder import RUN

    try:
        # Ray prints what happens to its workers, in between: on standard error it spoils no line of JSON.
        with (
            contextlib.redirect_stdout(sys.stderr),
            ray_workers(options.ray, options.ray_workers, settings) as workers,
        ):
            reporter.workers(workers.places, None)
            done = _run_trainer(options, settings, folder, before, reporter, workers)
            reporter.workers(workers.places, workers.restarts)
            return done
    except OperationFailed as error:
        kept = f"; the last checkpoint stands: --resume {folder.path}" if (folder.path / RUN).exists() else ""
        raise Rejected(f"{error}{kept}") from None


def _run_trainer(
    options: argparse.Namespace, settings: Any, folder: Any, before: Any, reporter: Any, workers: Any = None
) -> int:
    from twind.command_line.progress import ProgressLine
    from twind.command_line.stop_signals import catch_stop_signals
    from twind.learn.training.trainer import Trainer

    with catch_stop_signals() as stop, ProgressLine(options, "train") as progress:
        progress.update("making simulations, judging the zero policy")
        course = Trainer(settings, folder, reporter, before, options.tensorboard_log, workers)
        try:
            course.run(stop, progress)
        except OSError as error:
            raise Rejected(f"{folder.path}: {error.strerror or error}; the last checkpoint stands") from None
        except ValueError as error:  # a network that is not all numbers any more
            reason = " ".join(str(error).split())[:200]
            raise Rejected(f"{folder.path}: it broke down, the last checkpoint stands: {reason}") from None
        finally:
            course.close()
    return DONE
