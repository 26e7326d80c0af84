"""Real-time tests of learn training."""

import json
import signal
import subprocess
import sys
import threading
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

from tests.support.trainer_rig import TINY
from twind.command_line.progress import ProgressLine
from twind.learn.training.trainer import Trainer
from twind.learn.training.training_folder import (
    CHECKPOINT,
    lock_folder,
    read_run,
)
from twind.learn.training.training_reporter import TrainingReporter


def test_a_training_that_is_killed_goes_on(tmp_path: Path) -> None:
    out = tmp_path / "run"
    command = [sys.executable, "-m", "twind.ctl.ctl_main", "train", "--json", "stand", *TINY]
    with subprocess.Popen(
        [*command, "--steps", "1000000", "--evaluate-every", "64", "--out", str(out)],
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        evaluated = 0
        for line in process.stdout:
            evaluated += json.loads(line)["event"] == "evaluated"
            if evaluated == 2:  # the figures of the first are in the file
                break
        process.send_signal(signal.SIGKILL)
        process.wait()
    settings, before = read_run(out)
    assert before["ended"] is None
    with lock_folder(out) as folder:  # the lock went with the process
        done = before["steps"]
        course = Trainer(
            replace(settings, steps=done + 64), folder, TrainingReporter(Namespace(json=True)), before
        )
        assert course.run(threading.Event(), ProgressLine(Namespace(json=True), "train"))
        course.close()
    after = read_run(out)[1]
    # Killed between checkpoint and figures, the checkpoint is one evaluation ahead of them.
    assert after["steps"] in (done + 64, done + 128)
    assert [each["steps"] for each in after["evaluations"]][:2] == [64, 128]
    assert (out / CHECKPOINT).stat().st_size > 1000
