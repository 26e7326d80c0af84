"""Episodes of many robots at once: what both kinds of vector environment show, each in its own way.

An episode that ends is followed by the next one in the same step: no simulation ever waits a step, and no
transition has to be left out by a learner. The last observation of the old one is kept beside it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twind.learn.batch.batch_body import BatchBody
from twind.learn.randomise.disturbances import ReadingNoise
from twind.learn.randomise.identified_ranges import randomised_robot
from twind.learn.task.action_shaping import ActionShaper, ActionShaping
from twind.learn.task.learning_tasks import Command, command_of, task_of
from twind.learn.task.observation import BodyReading, ObservationBuilder, Observations
from twind.learn.task.observation_layout import COMMAND, PHASE
from twind.learn.task.plant_model import plant_of
from twind.learn.task.reward import RewardFunction
from twind.robot.arrays import Bools, Floats, Ints

Terms = dict[str, Any]  # of the reward, by name: arrays (count,)


@dataclass(frozen=True, slots=True)
class BatchStep:
    """Result of one control step. Arrays are new with each step: (count, …), but for those of `ended`."""

    observation: Observations  # of the next episode where one has ended
    reward: Floats
    fallen: Bools
    truncated: Bools  # out of time, fallen or not
    terms: Terms
    ended: Ints  # whose episode has ended
    last: Observations  # (len(ended), N): the last observation of those


class BatchCore:
    """`count` robots with one task; each draws from a generator of its own, as a single environment does."""

    def __init__(
        self,
        task: str,
        count: int,
        *,
        robot: str = "h24",
        randomise: str | None = None,
        identified: str | None = None,
        shaping: ActionShaping | None = None,
        episode_steps: int | None = None,
        threads: int | None = None,
        looks: bool = False,
    ) -> None:
        """As `env.RobotEnv`. `episode_steps`: None, as the task says; `threads`: None, every core; `looks`:
        pictures will be taken.

        Raises KeyError, ConfigError, InvalidInput, ValueError.
        """
        if count < 1:
            raise ValueError(f"{count} environments: at least one is needed")
        self.task = task_of(task)
        self.shaping = shaping or self.task.shaping
        period = self.shaping.period
        described = randomised_robot(robot, randomise, identified)
        ranges = self.task.ranges(described.ranges)
        self.plant = plant = plant_of(
            described.robot,
            period=period,
            action_delay=ranges.longest_action_delay,
            imu_delay=ranges.imu_delay[1],
            looks=looks,
        )
        self.count = count
        n = len(plant.default)
        self.episode_steps = episode_steps or self.task.steps(period)
        self.body = BatchBody(plant, ranges, period, count, threads)
        self._shaper = ActionShaper(plant.binding.limits, plant.default, self.shaping, (count,))
        self._observer = ObservationBuilder(plant.layout, plant.default, (count,))
        self._judge = RewardFunction(self.task, plant, (count,))
        self._noise, self._noise_of_one = (ReadingNoise(ranges.noise, n, each) for each in (count, 1))
        self._phases = self.task.phases(period)
        self._phase = np.zeros((count, PHASE))
        self._action = np.zeros((count, n))
        self.command = np.zeros((count, COMMAND))  # of the episode
        self._asked = np.zeros((count, COMMAND))  # now
        self._steps = np.zeros(count, np.int64)
        self.rngs: list[np.random.Generator] = [np.random.default_rng() for _ in range(count)]

    @property
    def joints(self) -> int:
        """Size of an action."""
        return len(self.plant.default)

    def seed(self, seeds: Sequence[int | None]) -> None:
        """Generators anew from `seeds`; where there is None the old one goes on."""
        for at, seed in enumerate(seeds):
            if seed is not None:
                self.rngs[at] = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed)))

    def reset(self, ids: Ints | None = None, command: Sequence[float] | None = None) -> Observations:
        """New episodes of robots `ids` (sorted; None: all). The observations of all, (count, N).

        `command`: forward, left (m/s), turn (rad/s), instead of drawn ones. Raises ValueError: it is not.
        """
        wanted = None if command is None else command_of(command)
        self._begin(np.arange(self.count) if ids is None else ids, wanted)
        return self._observe()

    def step(self, action: NDArray[Any]) -> BatchStep:
        """One control period of all; `action` (count, n).

        Raises ValueError: an action with NaN. Nothing moves by it; then reset.
        """
        self._action[:] = action
        target, _ = self._shaper.step(self._action)
        size = np.vecdot(target, target)
        if (size != size).any():  # NaN, before any robot receives it
            raise ValueError(f"robots {np.flatnonzero(size != size)}: an action is not all numbers: reset")
        reading = self.body.advance(target, self.rngs)
        reward, terms = self._judge.reward(reading, target, self._asked, self._phase)
        fallen = self._judge.fallen(reading)
        if np.count_nonzero(self.body.diverged):
            fallen |= self.body.diverged
            terms["diverged"] = self.body.diverged.copy()
        self._steps += 1
        self._turn()
        truncated = self._steps >= self.episode_steps
        self._noise.add(reading, self.rngs)
        observation = self._observe()
        ended = np.flatnonzero(fallen | truncated)
        last = observation[ended]
        if ended.size:
            self._begin(ended)
            observation = self._observe()
        return BatchStep(observation, reward, fallen, truncated, terms, ended, last)

    def _begin(self, ids: Ints, command: Command | None = None) -> None:
        for each in ids:
            drawn = self.task.draw_command(self.rngs[each])
            self.command[each] = drawn if command is None else command
        self._shaper.reset(at=ids)
        self._action[ids] = 0.0
        self._steps[ids] = 0
        self._turn()
        self.body.reset(ids, self.rngs)
        values = self.body.reading.values
        for each in ids:
            self._noise_of_one.add(BodyReading(values[each]), [self.rngs[each]])

    def _observe(self) -> Observations:
        return self._observer.observe(
            self.body.reading, self._action, self._shaper.target, self._asked, self._phase
        )

    def _turn(self) -> None:
        """The phase and the share of its command that each robot's steps have brought it to."""
        share = np.asarray(self.task.share(self._steps, self.shaping.period))
        np.multiply(self.command, share[..., None], self._asked)
        np.take(self._phases, self._steps % len(self._phases), axis=0, out=self._phase, mode="clip")
