"""Learning tasks as data: how an episode begins, its command, and the weight of each reward term.

`reward.py` computes the reward, in the same way for all tasks. A `reset` may ask for a command.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from twind.learn.randomise.randomisation_ranges import SAME, ZERO, PushRanges, RandomisationRanges, Span
from twind.learn.task.action_shaping import ActionShaping
from twind.learn.task.observation_layout import COMMAND
from twind.robot.arrays import Floats, frozen


@dataclass(frozen=True, slots=True)
class RewardWeights:
    """Weight of each term of the reward of one control step. A kernel is 1 / (1 + x²): at most 1."""

    alive: float = 0.0  # 1, until the robot has fallen
    velocity: float = 0.0  # kernel of how far the base's velocity is from what is asked for
    turn: float = 0.0  # kernel of how far its turning is
    upright: float = 0.0  # cosine of the tilt
    gait: float = 0.0  # kernel of how far the feet are from where the phase wants them
    energy: float = 0.0  # mean square of the torque, as a share of the most: what heats the motors
    pose: float = 0.0  # mean square of the way from the default pose (`imitates`: from the gait), rad²
    motion: float = 0.0  # mean square of the joints' velocities, rad²/s²


@dataclass(frozen=True)
class LearningTask:
    """One thing to learn, as data. Spans are [low, high]."""

    name: str
    weights: RewardWeights
    episode: float = 20.0  # s
    command: tuple[Span, Span, Span] = (ZERO, ZERO, ZERO)  # m/s forward, m/s left, rad/s turn
    stride: float = 0.0  # s of one step of both feet; 0: the feet stay
    clearance: float = 0.03  # m that a foot is lifted
    # Where the ranges of randomisation say nothing of them, an episode has these all the same.
    start: Mapping[str, Span] = field(default_factory=dict)
    pushes: PushRanges | None = None
    # x, each joint's position gain, over whatever the ranges draw of it.
    stiffness: Span = SAME
    ramp: float = 0.0  # s in which the command of an episode grows from zero
    imitates: bool = False  # the pose is judged against the gait of the walking engine, not the default pose
    shaping: ActionShaping = field(default_factory=ActionShaping)

    def ranges(self, given: RandomisationRanges) -> RandomisationRanges:
        """`given`, with this task's own start and pushes where it says nothing of them, and its stiffness."""
        own = {name: span for name, span in self.start.items() if getattr(given, name) == ZERO}
        soft = self.stiffness[0] * given.stiffness[0], self.stiffness[1] * given.stiffness[1]
        pushes = given.pushes or self.pushes
        return replace(given, pushes=pushes, stiffness=soft, **own)  # type: ignore[arg-type]

    def draw_command(self, rng: np.random.Generator) -> Floats:
        """Draw the command of one episode, (3,): m/s forward, m/s left, rad/s turn."""
        low, high = np.array(self.command).T
        command: Floats = low + rng.random(COMMAND) * (high - low)
        return command

    def phases(self, period: float) -> Floats:
        """(k, 4): sin and cos of the phase of left and right foot in each of the k control steps of a stride.

        The left foot swings in the first half of the stride, the right one in the second. Of feet that stay:
        one row, sin 0.
        """
        count = max(1, round(self.stride / period))
        turn = 2.0 * np.pi * np.arange(count) / count
        feet = (turn, turn + np.pi) if self.stride else (turn, turn)
        return frozen(np.stack([each(foot) for foot in feet for each in (np.sin, np.cos)], axis=1))

    def share(self, steps: Any, period: float) -> Any:
        """Return the share of the command that is asked for after `steps` control steps."""
        return np.minimum(1.0, steps * period / self.ramp) if self.ramp else 1.0

    def steps(self, period: float) -> int:
        """Number of control steps of an episode."""
        return round(self.episode / period)


STAND = LearningTask(
    name="Stand",
    episode=10.0,
    weights=RewardWeights(alive=1.0, velocity=0.5, upright=0.5, energy=-1.0, pose=-0.5, motion=-0.005),
    start={
        "start_joints": (-0.05, 0.05),
        "start_tilt": (-0.03, 0.03),
        "start_velocity": (-0.1, 0.1),
        "action_delay": (0.01, 0.025),  # s; a loop of 100 Hz takes 16 ms, measured over the bus
    },
    # On stiff servos holding the pose bears light pushes, and short trainings found no better. Soft ones
    # (of h24 a P gain of 400 to 720, where the factory has 800) tip over in it. A constant lean backwards
    # keeps most of them up: what is learnt here need not be feedback (docs/learn.md has the figures).
    stiffness=(0.25, 0.45),
    pushes=PushRanges(every=(1.0, 3.0), speed=(0.05, 0.15), lasting=(0.1, 0.2)),
)
HUMANOID = LearningTask(
    name="Humanoid",
    weights=RewardWeights(
        alive=0.5, velocity=2.0, turn=0.5, upright=0.5, gait=0.5, energy=-0.5, pose=-0.2, motion=-0.002
    ),
    command=((0.1, 0.3), ZERO, ZERO),
    stride=0.6,
    start={"start_joints": (-0.03, 0.03), "start_tilt": (-0.02, 0.02)},
)
# The engine's gait at 0.15 m/s needs nearly all that the legs of h24-standing can accelerate.
WALK = LearningTask(
    name="Walk",
    weights=RewardWeights(
        alive=0.5, velocity=1.0, turn=0.3, upright=0.3, energy=-0.2, pose=-100.0, motion=-0.001
    ),
    command=((0.0, 0.17), (-0.02, 0.02), (-0.2, 0.2)),
    stride=1.4,
    ramp=3.2,
    start={
        "start_joints": (-0.03, 0.03),
        "start_tilt": (-0.02, 0.02),
        "action_delay": (0.01, 0.025),  # s; a loop of 100 Hz takes 16 ms, measured over the bus
    },
    pushes=PushRanges(every=(2.0, 5.0), speed=(0.02, 0.08), lasting=(0.1, 0.2)),
    imitates=True,
    shaping=ActionShaping(reach=0.7, smoothing=1.0, velocity_share=0.95, acceleration_share=0.9),
)
TASKS: Mapping[str, LearningTask] = {task.name: task for task in (STAND, HUMANOID, WALK)}


def task_of(name: str) -> LearningTask:
    """Return a task by its name: `Stand`, `Humanoid`, `Walk`.

    Raises KeyError with the known names where there is none such.
    """
    for known, task in TASKS.items():
        if known.lower() == name.lower():
            return task
    raise KeyError(f"no task {name!r}: {', '.join(TASKS)}")


Command = tuple[float, float, float]
MOST = 5.0  # m/s, m/s, rad/s: what an observation can say of a command


def command_in(options: Mapping[str, Any] | None, *others: str) -> Command | None:
    """The command in them, None: a drawn one. `others`: what else may stand there.

    Raises ValueError: another option, or no command.
    """
    given = options or {}
    known = ("command", *others)
    for name in given:
        if name not in known:
            raise ValueError(f"option {name!r}: {' or '.join(known)}")
    return None if given.get("command") is None else command_of(given["command"])


def command_of(given: Sequence[float]) -> Command:
    """Forward, left (m/s), turn (rad/s). Raises ValueError: it is not that."""
    try:
        command = np.array(given, np.float64)
    except (TypeError, ValueError):
        command = np.zeros(0)
    if command.shape != (COMMAND,) or not (np.abs(command) <= MOST).all():
        raise ValueError(
            f"command {given!r}: three numbers are needed, m/s forward, m/s left and rad/s of turning, "
            f"each within ±{MOST:g}"
        )
    forward, left, turn = command.tolist()
    return forward, left, turn
