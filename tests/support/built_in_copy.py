"""Copies of built-in robots, to be changed by a test."""

import shutil
from pathlib import Path

from twind.config.robot_file import load_robot


def copy_built_in(name: str, folder: Path) -> Path:
    """Copy robot file, model and what the model includes into `folder`; return the robot file."""
    robot = load_robot(name)
    for path in (robot.path, robot.mjcf_path, robot.mjcf_path.with_name("servos.xml")):
        shutil.copy(path, folder)
    return folder / robot.path.name


def change(path: Path, before: str, after: str) -> None:
    """Replace a text of a file, which must be there."""
    text = path.read_text()
    assert before in text, (path, before)
    path.write_text(text.replace(before, after))
