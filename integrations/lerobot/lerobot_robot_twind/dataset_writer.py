"""Episodes of recordings as a data set of LeRobot, in the units and names of `TwindRobot`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from twind.learn.dataset.episode_collection import DatasetContents
from twind.learn.dataset.episode_frames import ACTION, STATE, VELOCITY, EpisodeFrames

ANGLES = (STATE, VELOCITY, ACTION)  # rad in recordings, degrees here
SUFFIXES = {STATE: ".pos", ACTION: ".pos"}
DONE = "next.done"
SUCCESS = "next.success"


def write(contents: DatasetContents, folder: Path) -> None:
    """Write the data set into `folder`, which must not exist. Raises OSError."""
    dataset = LeRobotDataset.create(
        f"twind/{contents.robot_type}",
        contents.fps,
        _features(contents),
        root=folder,
        robot_type=contents.robot_type,
        use_videos=False,
    )
    for episode in contents.episodes:
        columns = {name: _column(name, episode) for name in contents.features}
        for row in range(episode.count):
            last = row == episode.count - 1
            frame = {name: column[row] for name, column in columns.items()}
            frame |= {name: np.array([at_end and last]) for name, at_end in _ends(contents, episode).items()}
            dataset.add_frame({**frame, "task": episode.task})
        dataset.save_episode()
    dataset.finalize()


def _features(contents: DatasetContents) -> dict[str, dict[str, Any]]:
    features = {}
    for name in contents.features:
        names = [each + SUFFIXES.get(name, "") for each in contents.names(name)]
        features[name] = {"dtype": "float32", "shape": (len(names),), "names": names}
    ends = _ends(contents, contents.episodes[0])
    return features | {name: {"dtype": "bool", "shape": (1,), "names": None} for name in ends}


def _column(name: str, episode: EpisodeFrames) -> np.ndarray:
    column = episode.columns[name]
    return np.degrees(column) if name in ANGLES else column


def _ends(contents: DatasetContents, episode: EpisodeFrames) -> Mapping[str, bool]:
    """Return what the last frame of an episode says, by column."""
    return {DONE: True} | ({SUCCESS: bool(episode.success)} if contents.has_success_marks else {})
