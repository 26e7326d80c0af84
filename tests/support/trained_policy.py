"""A policy for Stand-v0, trained from scratch in test-sized runs: once for each state of the code, and kept.

Two tests want it, in two runs of pytest: what is judged against the zero policy is what stands on the robot.
So short a run ends anywhere between 20 and 65 % of falls, by its seed and by the rounding of the processor.
The best of three is taken, as the evaluation in simulation ranks them.
"""

import argparse
import hashlib
import threading
from pathlib import Path

import pytest

import twind.learn
from twind.command_line.progress import ProgressLine
from twind.learn.training.trainer import Trainer
from twind.learn.training.training_folder import BEST, RUN, lock_folder, read_run
from twind.learn.training.training_reporter import TrainingReporter
from twind.learn.training.training_settings import TrainingSettings, make_settings

STEPS = 61_440  # 30 updates; 30 s of CPU
SEEDS = (0, 1, 2)


def settings(seed: int = 0) -> TrainingSettings:
    """The defaults, but shorter and with fewer evaluations."""
    return make_settings("Stand", {"steps": STEPS, "evaluate_every": 20_480, "seed": seed})


def train(folder: Path, wanted: TrainingSettings) -> Path:
    """Train in `folder`, or take what was trained there. The policy file."""
    options = argparse.Namespace(json=True)
    with lock_folder(folder) as mine:
        if not (folder / RUN).exists() or read_run(folder)[1]["ended"] != "done":
            course = Trainer(wanted, mine, TrainingReporter(options), None)
            try:
                course.run(threading.Event(), ProgressLine(options, "train"))
            finally:
                course.close()
    return folder / BEST


def policy(config: pytest.Config) -> Path:
    """The policy file of the best seed, of the code as it is.

    It lies outside the folder of `config.cache`, because each run of `make check` has a cache of its own.
    """
    room = Path(twind.learn.__file__).parent
    state = hashlib.sha256(repr([settings(seed) for seed in SEEDS]).encode())
    for each in sorted(room.rglob("*.py")) + sorted((room.parent / "robots").glob("h24.*")):
        state.update(each.read_bytes())
    kept = config.rootpath / ".pytest_cache" / f"stand-{state.hexdigest()[:16]}"
    kept.mkdir(parents=True, exist_ok=True)
    folders = [kept / f"seed-{seed}" for seed in SEEDS]
    for folder, seed in zip(folders, SEEDS, strict=True):
        train(folder, settings(seed))
    return max(folders, key=_returns) / BEST


def _returns(folder: Path) -> float:
    """Mean return of the best policy of a training, as its evaluation in simulation found it."""
    return float(read_run(folder)[1]["best"]["returns"])
