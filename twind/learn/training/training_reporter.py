"""Output of a training: a growing table for people, a line of JSON per report with --json."""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

from twind.command_line.verb import show
from twind.learn.training.evaluation import EvaluationScore
from twind.learn.training.training_settings import TrainingSettings

HEAD = f"{'steps':>10} {'steps/s':>8} {'return':>8} {'against zero':>12} {'length':>7} {'fell':>6} {'m/s':>6}"


@dataclass(frozen=True, slots=True)
class TrainingReporter:
    """Printer of the reports in the form that the options select."""

    options: argparse.Namespace
    file: TextIO | None = None  # None: standard output

    def began(self, settings: TrainingSettings, path: Path, done: int, zero: EvaluationScore) -> None:
        """Print what is trained, and `zero`, the score of the policy that does nothing, as the reference."""
        lines = [
            f"{settings.task} with {settings.robot}: {_count(settings.steps)} steps of {settings.envs}"
            f" environments ({settings.kind}), seed {settings.seed}, randomised: {settings.randomisation}",
            f"into {path}" + (f", going on after {_count(done)} steps" if done else ""),
            "",
            "Each line is an evaluation on simulations of its own, with the same seeds every time.",
            "return: mean sum of rewards of an episode; against zero: how much more that is than holding the",
            f"default pose gives; length: of an episode, in control steps, of {zero.longest}; fell: share of",
            "episodes that ended by a fall; m/s: mean speed forward.",
            "* marks the best so far: policy.onnx.",
            "",
            HEAD,
            _row("zero", "", zero, zero, ""),
        ]
        data = {
            "event": "began",
            "settings": settings.to_json(),
            "out": str(path),
            "steps": done,
            "zero": zero.to_json(),
        }
        self._show(data, "\n".join(lines))

    def evaluated(
        self, steps: int, rate: float, score: EvaluationScore, zero: EvaluationScore, best: bool
    ) -> None:
        """One evaluation; `rate` in control steps a second since the last one."""
        data = {
            "event": "evaluated",
            "steps": steps,
            "steps_per_s": rate,
            "best": best,
            "score": score.to_json(),
        }
        self._show(data, _row(_count(steps), f"{rate:.0f}", score, zero, " *" if best else ""))

    def progress(self, steps: int, rate: float, recent: tuple[float, float, float] | None) -> None:
        """Print the progress after an update; with --json only, as a terminal shows the bar."""
        if self.options.json:
            names = ("return", "length", "falls")
            known = dict(zip(names, recent, strict=True)) if recent else dict.fromkeys(names)
            self._show({"event": "progress", "steps": steps, "steps_per_s": rate, **known}, "")

    def workers(self, places: Sequence[tuple[str, int]], restarts: int | None) -> None:
        """Print where the workers of Ray run: machine and process id; at the end, how many started again."""
        hosts = len({host for host, _ in places})
        known = "" if restarts is None else f", {restarts} started again after they died"
        data = {"event": "workers", "workers": [list(each) for each in places], "restarts": restarts or 0}
        machines = "one machine" if hosts == 1 else f"{hosts} machines"
        self._show(data, f"Ray: {len(places)} workers on {machines}{known}")

    def ended(
        self, path: Path, steps: int, whole: bool, best: EvaluationScore | None, zero: EvaluationScore
    ) -> None:
        """Print the result, and how to go on."""
        data: dict[str, object] = {"event": "ended", "steps": steps, "done": whole, "out": str(path)}
        data |= {"zero": zero.to_json(), "best": best.to_json() if best else None}
        lines = ["", f"{'done' if whole else 'stopped'} after {_count(steps)} steps: {path}"]
        if best is not None:
            lines += _verdict(best, zero, path)
        if not whole:
            lines.append(f"  twindctl train --resume {path} goes on with it")
        self._show(data, "\n".join(lines))

    def _show(self, data: Any, text: str) -> None:
        show(self.options, data, text, self.file)


def bar(steps: int, rate: float, recent: tuple[float, float, float] | None) -> str:
    """Return the text that stands after the bar."""
    line = f"{_count(steps)} steps, {rate:.0f}/s"
    if recent is None:
        return line
    returns, length, falls = recent
    return f"{line}, return {returns:.0f}, length {length:.0f}, fell {falls:.0%}"


def _verdict(best: EvaluationScore, zero: EvaluationScore, path: Path) -> list[str]:
    result = (
        f"  policy.onnx: return {best.returns:.1f} (zero policy {zero.returns:.1f}),"
        f" fell in {best.falls:.0%} of {best.episodes} episodes (zero policy {zero.falls:.0%})"
    )
    if best.returns <= zero.returns:
        return [result, "  It is no better than doing nothing: train longer, or with other settings."]
    return [
        result,
        f"  twindctl policy show {path / 'policy.onnx'} says what it is for; `policy run` drives with it",
    ]


def _row(steps: str, rate: str, score: EvaluationScore, zero: EvaluationScore, mark: str) -> str:
    more = "" if score is zero else f"{score.returns - zero.returns:+.1f}"
    return (
        f"{steps:>10} {rate:>8} {score.returns:>8.1f} {more:>12} {score.length:>7.0f} {score.falls:>6.0%}"
        f" {score.speed:>6.2f}{mark}"
    )


def _count(steps: int) -> str:
    return f"{steps:,}".replace(",", " ")
