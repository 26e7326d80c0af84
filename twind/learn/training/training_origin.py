"""Hashes of the files that a training is made from.

Two trainings with the same files and the same settings differ in nothing else.
"""

import hashlib
from dataclasses import replace

from twind.config.robot_file import load_robot
from twind.config.yaml_tree import read_text
from twind.learn.randomise.randomisation_ranges import file_of
from twind.learn.training.training_settings import TrainingSettings


def originated(settings: TrainingSettings) -> TrainingSettings:
    """Return the settings with the current hashes of their files.

    These are the robot file with its MJCF (without meshes), and the file of ranges. Raises ConfigError.
    """
    robot = load_robot(settings.robot)
    profile = settings.profile
    ranges = "" if profile is None else _hash(read_text(file_of(profile)))
    return replace(settings, robot_sha256=_hash(robot.text_sha256 + robot.mjcf), profile_sha256=ranges)


def describe_changes(settings: TrainingSettings) -> list[str]:
    """Return a sentence for each file that has changed since the training began. Raises ConfigError."""
    now = originated(settings)
    found = []
    if now.robot_sha256 != settings.robot_sha256:
        found.append(f"the robot file {settings.robot} or its MJCF has changed since")
    if now.profile_sha256 != settings.profile_sha256:
        found.append(f"the ranges of {settings.profile} have changed since")
    return found


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
