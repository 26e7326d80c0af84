"""The environments: a task, a robot file and a body, as Gymnasium wants them."""

from collections.abc import Mapping
from typing import Any, Protocol

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from twind.learn.environment.camera_renderer import CameraRenderer
from twind.learn.environment.daemon_body import DaemonBody
from twind.learn.environment.sim_body import SimBody
from twind.learn.randomise.disturbances import ReadingNoise
from twind.learn.randomise.identified_ranges import randomised_robot
from twind.learn.randomise.randomisation_ranges import RandomisationRanges
from twind.learn.task.action_shaping import ActionShaper, ActionShaping
from twind.learn.task.learning_tasks import command_in, task_of
from twind.learn.task.observation import BodyReading, ObservationBuilder
from twind.learn.task.plant_model import Plant, plant_of
from twind.learn.task.reward import RewardFunction
from twind.robot.arrays import Floats

BACKENDS = ("sim", "daemon")


class RobotBody(Protocol):
    """Body that takes targets and gives readings: a simulation, or a robot behind its daemon."""

    model: Any  # mujoco.MjModel and
    data: Any  # mujoco.MjData: how it stands, for a picture

    @property
    def diverged(self) -> bool:
        """True if the last reading is of no use: the episode must end."""

    @property
    def step_info(self) -> Mapping[str, object]:
        """Further entries of `info` for the last step."""

    def reset(self, rng: np.random.Generator) -> BodyReading:
        """Stand in the default pose, as well as can be; what may differ is drawn from `rng`."""

    def advance(self, target: Floats, velocity: Floats) -> BodyReading:
        """One control period; the joints (n,) are to be at `target`, rad, at its end, with `velocity`, rad/s.

        The reading is the body's own: it changes with the next call.
        """

    def close(self) -> None:
        """Give back what is held; may be called twice."""


class RobotEnv(gymnasium.Env):
    """One robot with one task. Observations are new arrays; reward terms stand in `info` by name.

    It ends its episodes by itself, in time too.
    """

    metadata: Mapping[str, object] = {
        "render_modes": ["rgb_array"],
        "render_fps": round(1.0 / ActionShaping().period),
    }

    def __init__(
        self,
        task: str,
        robot: str = "h24",
        backend: str = "sim",
        render_mode: str | None = None,
        randomise: str | None = None,
        identified: str | None = None,
        socket: str | None = None,
        shaping: ActionShaping | None = None,
        episode_steps: int | None = None,
    ) -> None:
        """`robot`: name or path of a robot file; `backend`: sim or daemon (at `socket`, None: the usual one).

        `randomise`: a profile of the ranges, or a file of them; `identified`: file of an identified model,
        whose uncertainties take the place of ranges; `episode_steps`: None, as the task says.
        Raises KeyError, ConfigError, InvalidInput, ValueError.
        """
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode {render_mode!r}: None or 'rgb_array', which `render()` returns")
        if backend != "sim" and randomise not in (None, "none"):
            raise ValueError(f"randomise {randomise!r} with backend {backend!r}: it is of simulations alone")
        self.render_mode = render_mode
        self.task = task_of(task)
        self.shaping = shaping or self.task.shaping
        described = randomised_robot(robot, randomise, identified)
        ranges = self.task.ranges(described.ranges)
        self.plant = plant = plant_of(
            described.robot,
            period=self.shaping.period,
            action_delay=ranges.longest_action_delay,
            imu_delay=ranges.imu_delay[1],
            looks=render_mode is not None,
        )
        self.body: RobotBody = _body(plant, ranges, self.shaping, backend, socket)
        self.shaper = ActionShaper(plant.binding.limits, plant.default, self.shaping)
        self._observer = ObservationBuilder(plant.layout, plant.default)
        self._judge = RewardFunction(self.task, plant)
        self._noise = ReadingNoise(ranges.noise, len(plant.default))
        self._phases = self.task.phases(self.shaping.period)
        self._command = np.zeros(3)  # of the episode
        self._asked = np.zeros(3)  # now
        self._phase = self._phases[0]
        self._steps = 0
        self.metadata = {**self.metadata, "render_fps": round(1.0 / self.shaping.period)}
        self.episode_steps = episode_steps or self.task.steps(self.shaping.period)
        self._rngs: list[np.random.Generator] = []
        self._picture: CameraRenderer | None = None
        self.observation_space, self.action_space = spaces_of(plant)

    def reset(
        self, *, seed: int | None = None, options: dict[str, object] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, object]]:
        """Begin an episode. `options`: {"command": (m/s forward, m/s left, rad/s)} or a drawn one.

        Raises ValueError: other options, or no command that can be.
        """
        command = command_in(options)
        super().reset(seed=seed)
        rng = self.np_random
        self._rngs = [rng]
        drawn = self.task.draw_command(rng)
        self._command = drawn if command is None else np.array(command)
        self.shaper.reset()
        self._steps = 0
        self._phase = self._phases[0]
        self._asked = self._command * self.task.share(0, self.shaping.period)
        reading = self.body.reset(rng)
        observation = self._observe(reading, np.zeros(len(self.plant.default)))
        return observation, {"command": tuple(self._command.tolist())}

    def step(self, action: NDArray[Any]) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, object]]:
        """One control period. Raises ValueError: an action with NaN; ResetNeeded. Nothing moves by either."""
        if not self._rngs:
            raise ResetNeeded("no episode has begun: reset() first")
        target, velocity = self.shaper.step(action)
        size = target.dot(target)
        if size != size:  # NaN, before the body receives it
            raise ValueError(f"the action {action} is not all numbers: reset, and look at the policy")
        reading = self.body.advance(target, velocity)
        reward, terms, fallen = self._judge.verdict(reading, target, self._asked, self._phase)
        if self.body.diverged:
            fallen = True
            terms["diverged"] = True
        if self.body.step_info:
            terms |= self.body.step_info
        self._steps += 1
        self._phase = self._phases[self._steps % len(self._phases)]
        self._asked = self._command * self.task.share(self._steps, self.shaping.period)
        return self._observe(reading, action), reward, fallen, self._steps >= self.episode_steps, terms

    def render(self) -> NDArray[np.uint8] | None:
        """The robot from the side, (height, width, 3); None without render_mode."""
        if self.render_mode is None:
            return None
        if self._picture is None:
            self._picture = CameraRenderer(self.body.model, self.plant.binding.robot.base)
        return self._picture.take(self.body.data)

    def close(self) -> None:
        """Let go of the body and of the picture."""
        self.body.close()
        if self._picture is not None:
            self._picture.close()
            self._picture = None

    def _observe(self, reading: BodyReading, action: NDArray[Any]) -> NDArray[np.float32]:
        if not self._noise.silent:
            self._noise.add(reading, self._rngs)
        return self._observer.observe(reading, action, self.shaper.target, self._asked, self._phase)


def spaces_of(plant: Plant) -> tuple[spaces.Box, spaces.Box]:
    """Return the observation space and the action space of one robot."""
    most = plant.layout.most.astype(np.float32)
    return spaces.Box(-most, most, dtype=np.float32), spaces.Box(-1.0, 1.0, plant.default.shape, np.float32)


def _body(
    plant: Plant, ranges: RandomisationRanges, shaping: ActionShaping, backend: str, socket: str | None
) -> RobotBody:
    """Raises ValueError: no such back end."""
    if backend == "sim":
        return SimBody(plant, ranges, shaping.period)
    if backend == "daemon":
        return DaemonBody(plant, shaping, socket)
    raise ValueError(f"backend {backend!r}: {' or '.join(BACKENDS)}")
