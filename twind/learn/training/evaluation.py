"""Evaluation of a policy: whole episodes on simulations of their own, with the same seeds every time.

The reference is the policy that does nothing and holds the default pose. A score that is not better shows
that nothing was learnt.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from twind.learn.batch.batch_core import BatchCore
from twind.learn.training.training_settings import TrainingSettings

FIRST_SEED = (
    1_000_000  # training takes seeds drawn from all 32 bits: that these come up is one in a thousand runs
)
Rows = NDArray[np.float32]
Act = Callable[[Rows], Rows]


@dataclass(frozen=True, slots=True)
class EvaluationScore:
    """Score of the episodes of one evaluation. Means over episodes."""

    returns: float  # sum of rewards of an episode
    deviation: float  # of the returns, between episodes
    length: float  # control steps until it fell or the time was up
    longest: int  # control steps of an episode without a fall
    falls: float  # share of the episodes that ended by a fall
    speed: float  # m/s forward, of the base, over all steps
    jitter: float  # mean change of an action from step to step: how restless it is
    episodes: int

    def to_json(self) -> dict[str, object]:
        """Return the fields by name."""
        return asdict(self)


class EvaluationEnvs:
    """The simulations of an evaluation, kept from one to the next."""

    def __init__(
        self, settings: TrainingSettings, *, episodes: int | None = None, first_seed: int = FIRST_SEED
    ) -> None:
        """As the training has them, but `episodes` of them: one each. Raises what `Core` does."""
        count = episodes or settings.episodes
        self.core = BatchCore(
            settings.task,
            count,
            robot=settings.robot,
            randomise=settings.profile,
            identified=settings.identified,
        )
        self._seeds = [first_seed + place for place in range(count)]

    def zero(self) -> EvaluationScore:
        """Return the score of the policy that does nothing."""
        action = np.zeros((self.core.count, self.core.joints), np.float32)
        return self.judge(lambda _: action)

    def judge(self, act: Act) -> EvaluationScore:
        """`act`: observations (k, N) -> actions (k, n). The same `act` gives the same score, to the bit."""
        core = self.core
        count = self.core.count
        core.seed(self._seeds)
        observation = core.reset()
        returns = np.zeros(count)
        lengths = np.zeros(count)
        fallen = np.zeros(count, np.bool_)
        runs = np.ones(count, np.bool_)
        last: Rows = np.zeros((count, core.joints), np.float32)
        moved = 0.0
        ahead = 0.0
        while runs.any():
            action = act(observation)
            moved += float(np.abs(action - last)[runs].mean(axis=1).sum())
            ahead += float(core.body.reading.base_velocity[runs, 0].sum())
            last = action
            step = core.step(action)
            observation = step.observation
            returns[runs] += step.reward[runs]
            lengths[runs] += 1.0
            fallen |= step.fallen & runs
            runs &= ~(step.fallen | step.truncated)
        return EvaluationScore(
            returns=float(returns.mean()),
            deviation=float(returns.std()),
            length=float(lengths.mean()),
            longest=core.episode_steps,
            falls=float(fallen.mean()),
            speed=ahead / float(lengths.sum()),
            jitter=moved / float(lengths.sum()),
            episodes=count,
        )
