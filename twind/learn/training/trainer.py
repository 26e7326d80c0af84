"""One training from end to end: updates, an evaluation now and then, and after each a checkpoint.

Killed at any moment it goes on from the last checkpoint. That is written after what was judged with it, so
the figures of a run never know more steps than its checkpoint.
"""

import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from platform import python_version
from time import monotonic
from typing import Any

from twind.command_line.progress import ProgressLine
from twind.command_line.verb import Rejected
from twind.learn.policy.policy_file import read
from twind.learn.training import learning_curve_figure
from twind.learn.training.evaluation import EvaluationEnvs, EvaluationScore
from twind.learn.training.ppo_learner import THREADS, PpoLearner, export
from twind.learn.training.training_folder import BEST, CANDIDATE, CHECKPOINT, CURVE, LAST, TrainingFolder
from twind.learn.training.training_reporter import TrainingReporter, bar
from twind.learn.training.training_settings import TrainingSettings
from twind.version import __version__

PACKAGES = ("torch", "stable-baselines3", "gymnasium", "mujoco-core", "numpy", "onnx")


@dataclass(slots=True)
class TrainingFigures:
    """Results of a run so far."""

    zero: EvaluationScore
    points: list[tuple[int, EvaluationScore]] = field(default_factory=list)
    seconds: float = 0.0  # of training, evaluations not counted

    @property
    def best(self) -> tuple[int, EvaluationScore] | None:
        """Steps and score of the best evaluation, the first of equals."""
        return max(self.points, key=lambda point: point[1].returns, default=None)

    def to_json(self, steps: int, ended: str | None) -> dict[str, object]:
        """As they stand in the run's file. `ended`: done, stopped, or None while it runs."""
        best = self.best
        return {
            "ended": ended,
            "steps": steps,
            "seconds": round(self.seconds, 1),
            "steps_per_s": round(steps / self.seconds, 1) if self.seconds else None,
            "best": {"steps": best[0], **best[1].to_json()} if best else None,
            "zero": self.zero.to_json(),
            "evaluations": [{"steps": at, **score.to_json()} for at, score in self.points],
            "torch_threads": THREADS,
            "versions": {
                "python": python_version(),
                "twind": __version__,
                **{name: version(name) for name in PACKAGES},
            },
        }


class Trainer:
    """A training in a folder that is ours."""

    def __init__(
        self,
        settings: TrainingSettings,
        folder: TrainingFolder,
        reporter: TrainingReporter,
        before: Mapping[str, object] | None,
        logs: Path | None = None,
        workers: Any = None,
    ) -> None:
        """`before`: the run's file of a training that goes on; `logs`: folder for TensorBoard.

        `workers`: `RolloutWorkers` that collect, else this process does.

        Raises Rejected: its checkpoint is none.
        """
        self._settings = settings
        self._folder = folder
        self._reporter = reporter
        state = None if before is None else _checkpoint(folder.path / CHECKPOINT)
        try:
            self._learner = PpoLearner(settings, state, logs, workers)
        except ValueError as error:
            where = folder.path if state is None else folder.path / CHECKPOINT
            raise Rejected(f"{where}: {error}") from None
        self._trials = EvaluationEnvs(settings)
        self._figures = TrainingFigures(self._trials.zero())
        if before is not None:
            self._take_up(before)
        self._rate = 0.0
        self._since = self._figures.seconds
        self._at = self._learner.steps

    def run(self, stop: threading.Event, progress: ProgressLine) -> bool:
        """Train until all steps are done (True) or `stop` is set (False). Raises OSError: a full disk."""
        learner = self._learner
        figures = self._figures
        settings = self._settings
        began = learner.steps
        progress.clear()
        self._reporter.began(settings, self._folder.path, began, figures.zero)
        self._keep(None)
        due = _next(began, settings.evaluate_every)
        while learner.steps < settings.steps and not stop.is_set():
            begun = monotonic()
            learner.update()
            figures.seconds += monotonic() - begun
            self._report_progress(progress, began)
            if learner.steps >= due and learner.steps < settings.steps:
                self._evaluate(progress)
                self._keep(None)
                due = _next(learner.steps, settings.evaluate_every)
        whole = learner.steps >= settings.steps
        if learner.steps and not self._judged:
            self._evaluate(progress)
        self._keep("done" if whole else "stopped")
        best = figures.best
        progress.clear()
        self._reporter.ended(self._folder.path, learner.steps, whole, best[1] if best else None, figures.zero)
        return whole

    def close(self) -> None:
        """Give the environments back."""
        self._learner.close()

    def _take_up(self, before: Mapping[str, Any]) -> None:
        steps = self._learner.steps
        try:
            rows = [dict(each) for each in before["evaluations"]]
            points = [(int(each.pop("steps")), EvaluationScore(**each)) for each in rows]
            self._figures.seconds = float(before["seconds"])
        except (KeyError, TypeError, ValueError) as error:
            raise Rejected(f"{self._folder.path}: its evaluations cannot be read: {error}") from None
        self._figures.points = [point for point in points if point[0] <= steps]

    def _report_progress(self, progress: ProgressLine, began: int) -> None:
        steps = self._learner.steps
        recent = self._learner.recent()
        past = self._figures.seconds - self._since
        self._rate = (steps - self._at) / past if past > 0.0 else 0.0
        progress.update(
            bar(steps, self._rate, recent), (steps - began) / max(1, self._settings.steps - began)
        )
        self._reporter.progress(steps, self._rate, recent)

    def _evaluate(self, progress: ProgressLine) -> None:
        """Judge the policy as a robot would run it: from the file."""
        learner = self._learner
        figures = self._figures
        path = self._folder.path
        progress.update(f"evaluating on {self._settings.episodes} episodes")
        core = self._trials.core
        export(path / CANDIDATE, learner.model, self._settings, core, {})
        score = self._trials.judge(read((path / CANDIDATE).read_bytes()).act)
        (path / CANDIDATE).unlink()
        figures.points.append((learner.steps, score))
        learner.record({"mean_reward": score.returns, "mean_ep_length": score.length, "falls": score.falls})
        progress.clear()
        is_best = figures.best == figures.points[-1]
        self._reporter.evaluated(learner.steps, self._rate, score, figures.zero, is_best)
        self._since = figures.seconds
        self._at = learner.steps

    @property
    def _judged(self) -> bool:
        """The network as it is now."""
        points = self._figures.points
        return bool(points) and points[-1][0] == self._learner.steps

    def _keep(self, ended: str | None) -> None:
        """The checkpoint first, then what it amounts to, then the policies.

        Killed in between, what goes on from the checkpoint writes the policies that its figures speak of.
        """
        folder = self._folder
        figures = self._figures
        folder.write(CHECKPOINT, self._learner.state())
        folder.write_run(self._settings, figures.to_json(self._learner.steps, ended))
        if self._judged:
            self._export(figures.points[-1], figures.zero)
        if figures.points:
            best = figures.best
            settings = self._settings
            title = f"{settings.task} with {settings.robot}, seed {settings.seed}"
            made = learning_curve_figure.figure(
                title, figures.zero, figures.points, best[0] if best else None
            )
            folder.make(CURVE, lambda beside: learning_curve_figure.save(made, beside))

    def _export(self, point: tuple[int, EvaluationScore], zero: EvaluationScore) -> None:
        """The network as it is now, judged so."""
        score = point[1]
        figures_of_policy = {
            "return": score.returns,
            "length": score.length,
            "falls": score.falls,
            "speed": score.speed,
        }
        against = {"zero_return": zero.returns, "zero_length": zero.length}
        for name in (LAST, *([BEST] if self._figures.best == point else [])):
            export(
                self._folder.path / name,
                self._learner.model,
                self._settings,
                self._trials.core,
                figures_of_policy | against,
            )


def _checkpoint(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise Rejected(f"{path}: {error.strerror or error}; there is nothing to go on from") from None


def _next(steps: int, every: int) -> int:
    """The steps of the next evaluation."""
    return (steps // every + 1) * every
