"""A small training for the tests of the trainer."""

import threading
from argparse import Namespace
from typing import Any

from twind.command_line.progress import ProgressLine
from twind.learn.training.trainer import Trainer
from twind.learn.training.training_folder import (
    TrainingFolder,
)
from twind.learn.training.training_reporter import TrainingReporter
from twind.learn.training.training_settings import TrainingSettings

TINY = (
    "--steps",
    "128",
    "--envs",
    "2",
    "--rollout",
    "32",
    "--batch",
    "32",
    "--hidden",
    "16",
    "--episodes",
    "2",
)


def course(folder: TrainingFolder, settings: TrainingSettings, before: Any = None) -> None:
    """Run to its end."""
    options = Namespace(json=True)
    made = Trainer(settings, folder, TrainingReporter(options), before)
    try:
        assert made.run(threading.Event(), ProgressLine(options, "train"))
    finally:
        made.close()
