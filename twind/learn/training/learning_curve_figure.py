"""The curve of a training as a picture: return, length and falls by steps, beside the zero policy."""

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from twind.learn.training.evaluation import EvaluationScore

OURS, ZERO = "#0072b2", "#d55e00"
Point = tuple[int, EvaluationScore]  # steps, score


def figure(title: str, zero: EvaluationScore, points: Sequence[Point], best: int | None) -> Figure:
    """Three panels, one above the other. `best`: the steps whose policy is kept."""
    made = Figure(figsize=(8.0, 8.0), layout="constrained")
    FigureCanvasAgg(made)
    made.suptitle(title)
    panels = made.subplots(3, 1, sharex=True)
    steps = [each for each, _ in points]
    scores = [score for _, score in points]
    _returns(panels[0], zero, steps, scores)
    _lines(panels[1], "episode, control steps", zero.length, steps, [each.length for each in scores])
    panels[1].set_ylim(0, 1.05 * zero.longest)
    _lines(
        panels[2], "episodes with a fall, %", 100 * zero.falls, steps, [100 * each.falls for each in scores]
    )
    panels[2].set_ylim(-2, 102)
    panels[2].set_xlabel("control steps of all environments")
    panels[2].set_xlim(left=0)
    panels[2].xaxis.set_major_formatter(lambda value, _: f"{value:,.0f}".replace(",", " "))
    if best is not None:
        for panel in panels:
            panel.axvline(best, color="0.6", linestyle=":", linewidth=1.0, label="policy.onnx")
    panels[0].legend(loc="best", fontsize="small")
    return made


def _returns(
    panel: Axes, zero: EvaluationScore, steps: Sequence[int], scores: Sequence[EvaluationScore]
) -> None:
    low, high = ([each.returns + sign * each.deviation for each in scores] for sign in (-1, 1))
    panel.fill_between(steps, low, high, color=OURS, alpha=0.15, linewidth=0, label="± deviation of episodes")
    _lines(panel, "return", zero.returns, steps, [each.returns for each in scores])


def _lines(panel: Axes, label: str, zero: float, steps: Sequence[int], values: Sequence[float]) -> None:
    panel.plot(steps, values, color=OURS, marker="o", markersize=3, label="trained")
    panel.axhline(zero, color=ZERO, linestyle="--", linewidth=1.2, label="zero policy")
    panel.set_ylabel(label)
    panel.grid(color="0.9")


def save(made: Figure, path: Path) -> None:
    """As PNG. Raises OSError."""
    made.savefig(path, format="png", dpi=110)
