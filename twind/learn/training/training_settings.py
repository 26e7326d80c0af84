"""Settings of a training: task, robot, the figures of PPO, and hashes of the files that they name.

Kept with the run, and compared when it is resumed.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

from twind.config.robot_file import load_robot
from twind.config.yaml_tree import read_text
from twind.learn.randomise.randomisation_ranges import DEFAULT, file_of

KINDS = ("batch", "dummy", "subproc")  # how environments run: one batch, one after the other, a process each


@dataclass(frozen=True, slots=True)
class TrainingSettings:
    """All that decides how a training goes. Two runs with the same settings differ by nothing else."""

    task: str
    robot: str = "h24"  # name or path of a robot file
    profile: str | None = None  # of the ranges of randomisation, or a file of them
    identified: str | None = None  # file of the identified model that draws come from
    # of robot file and MJCF, as they were when the training began
    robot_sha256: str = ""
    profile_sha256: str = ""  # of the file of ranges
    identified_sha256: str = ""
    seed: int = 0
    steps: int = 61_440  # control steps, of all environments together
    envs: int = 8
    kind: str = "batch"
    rollout: int = 256  # steps of each environment between two updates
    batch: int = 256  # steps in one gradient step
    epochs: int = 5  # times that a rollout is looked at
    learning_rate: float = 3e-4  # at the beginning; falls to a twentieth with the steps
    gamma: float = 0.95  # what a reward one step later is worth
    gae_lambda: float = 0.95
    clip: float = 0.2
    std: float = 0.13  # of the actions that are tried, at the beginning: wider ones make every robot fall
    hidden: tuple[int, ...] = (64, 64)  # of actor and critic each, tanh
    evaluate_every: int = 20_000  # steps
    episodes: int = 20  # of each evaluation

    def __post_init__(self) -> None:
        """Raises ValueError: a figure that nothing can be trained with."""
        whole = ("steps", "envs", "rollout", "batch", "epochs", "evaluate_every", "episodes")
        for name in whole:
            if getattr(self, name) < 1:
                raise ValueError(f"{name.replace('_', ' ')} {getattr(self, name)}: at least 1 is needed")
        if not 0 <= self.seed < 2**32:
            raise ValueError(f"seed {self.seed}: 0 to {2**32 - 1} is needed")
        if self.rollout * self.envs < 2:
            raise ValueError("one step of one environment between two updates: at least 2 are needed")
        for name in ("learning_rate", "gae_lambda", "clip", "std"):
            if not 0.0 < getattr(self, name) <= 1.0:
                raise ValueError(
                    f"{name.replace('_', ' ')} {getattr(self, name):g}: above 0 and at most 1 is needed"
                )
        if not 0.0 < self.gamma < 1.0:
            raise ValueError(f"gamma {self.gamma:g}: above 0 and below 1 is needed")

    @property
    def randomisation(self) -> str:
        """Return the source of draws, as text."""
        if self.identified is None:
            return self.profile or "none"
        return f"{self.identified}, {self.profile or DEFAULT} for the rest"

    def to_json(self) -> dict[str, object]:
        """As it stands in the run's file."""
        return asdict(self) | {"hidden": list(self.hidden)}


# What is proven to train, by task: see docs/learn.md for what came of it.
DEFAULTS: Mapping[str, TrainingSettings] = {
    "Stand": TrainingSettings("Stand"),
    "Humanoid": TrainingSettings("Humanoid", steps=2_000_000, evaluate_every=100_000, gamma=0.99),
    "Walk": TrainingSettings(
        "Walk",
        robot="h24-standing",
        profile="walk",
        steps=2_000_000,
        envs=16,
        batch=1024,
        learning_rate=2e-4,
        gamma=0.99,
        std=0.06,
        hidden=(128, 128),
        evaluate_every=200_000,
    ),
}


def make_settings(task: str, given: Mapping[str, Any]) -> TrainingSettings:
    """The defaults of `task` with what was `given`. Raises ValueError."""
    return replace(DEFAULTS.get(task, TrainingSettings(task)), **given)


def settings_from_json(data: Mapping[str, Any]) -> TrainingSettings:
    """Build the settings from a run's file. Raises ValueError: not the settings of this version."""
    known = {each.name for each in fields(TrainingSettings)}
    since = {"identified", "identified_sha256"}  # absent in the files of earlier versions
    if not known - since <= set(data) <= known:
        other = ", ".join(sorted(known ^ set(data)))
        raise ValueError(f"its settings are not those of this twind: {other}")
    return TrainingSettings(**{**data, "hidden": tuple(data["hidden"])})


def differences(before: TrainingSettings, given: Mapping[str, object]) -> list[str]:
    """Return a sentence for each setting that differs from `before`. More steps are no difference."""
    found = []
    for name, value in given.items():
        was = getattr(before, name)
        if value != was and not (name == "steps" and value > was):
            found.append(f"{name.replace('_', ' ')} is {_format_value(was)}, not {_format_value(value)}")
    return found


def _format_value(value: Any) -> str:
    return "none" if value is None else f"{value:g}" if isinstance(value, float) else str(value)[:80]


def originated(settings: TrainingSettings) -> TrainingSettings:
    """Return the settings with the current hashes of their files.

    These are the robot file with its MJCF (without meshes), the file of ranges and the identified model.
    Raises ConfigError.
    """
    robot = load_robot(settings.robot)
    profile = settings.profile
    ranges = "" if profile is None else _hash(read_text(file_of(profile)))
    model = "" if settings.identified is None else _hash(read_text(Path(settings.identified)))
    return replace(
        settings,
        robot_sha256=_hash(robot.text_sha256 + robot.mjcf),
        profile_sha256=ranges,
        identified_sha256=model,
    )


def describe_changes(settings: TrainingSettings) -> list[str]:
    """Return a sentence for each file that has changed since the training began. Raises ConfigError."""
    now = originated(settings)
    found = []
    if now.robot_sha256 != settings.robot_sha256:
        found.append(f"the robot file {settings.robot} or its MJCF has changed since")
    if now.profile_sha256 != settings.profile_sha256:
        found.append(f"the ranges of {settings.profile} have changed since")
    if now.identified_sha256 != settings.identified_sha256:
        found.append(f"the identified model {settings.identified} has changed since")
    return found


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
