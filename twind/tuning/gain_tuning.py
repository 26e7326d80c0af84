"""Order of a tuning: try gains, step each joint, put the old gains back whatever happens. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from twind.exceptions import InvalidInput
from twind.tuning.gain_search import Gains, GainSearch, GainTry
from twind.tuning.step_response import StepResponse, worst

ABORT = 0.6  # overshoot, share of the step: beyond it no further joint is stepped with these gains


class TuningBench(Protocol):
    """Robot whose joints are stepped. Its methods raise errors of the connection, which end the tuning."""

    def apply(self, gains: Gains) -> None:
        """Put gains in force, torque on, at the place where the tuning began."""

    def step(self, joint: str) -> StepResponse:
        """Step one joint there and back. Raises InvalidInput: no response was recorded."""

    def restore(self) -> None:
        """Put the gains of the robot file in force again, torque off."""


@dataclass(frozen=True, slots=True)
class TuningResult:
    """Tries in order; the first has the gains of the robot file. `proposal` None: nothing is better."""

    tries: Sequence[GainTry]
    proposal: GainTry | None


def tune(bench: TuningBench, joints: Sequence[str], search: GainSearch, most: int) -> TuningResult:
    """Try gains at most `most` times, then restore. Raises what the bench raises, restored too."""
    try:
        while len(search.tries) < most and (gains := search.next()) is not None:
            bench.apply(gains)
            search.tries.append(_try(bench, joints, gains))
    finally:
        bench.restore()
    best = search.best
    better = best is not None and best is not search.tries[0] and search.is_fit(best)
    return TuningResult(search.tries, best if better else None)


def _try(bench: TuningBench, joints: Sequence[str], gains: Gains) -> GainTry:
    found = []
    for joint in joints:
        try:
            found.append(bench.step(joint))
        except InvalidInput as error:
            return GainTry(gains, None, f"{joint}: {error}")
        if found[-1].overshoot > ABORT:
            break
    return GainTry(gains, worst(found))
