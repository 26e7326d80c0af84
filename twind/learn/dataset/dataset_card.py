"""README.md of a data set: what its columns are, of what it was made, what is not in it. Pure text."""

from twind.learn.dataset.episode_collection import DatasetContents, line
from twind.learn.dataset.episode_frames import ACTION, EFFORT, IMU, STATE, VELOCITY

_MEANINGS = {
    STATE: "measured positions, rad: on the line between the two readings around",
    VELOCITY: "measured velocities, rad/s, likewise",
    EFFORT: "measured torques, N·m, likewise",
    IMU: "of the base, in its own axes: rad/s, m/s², unit quaternion w x y z; as it was last read",
    ACTION: "goals, rad: what passed the gate and was last sent at the frame's time. "
    "What was asked for before the gate is not recorded",
}
_HEAD = """\
---
task_categories:
- robotics
tags:
- LeRobot
configs:
- config_name: default
  data_files: data/*/*.parquet
---
"""


def card(of: DatasetContents) -> str:
    """The text; the same of the same recordings."""
    return _HEAD + "\n".join(_lines(of)) + "\n"


def absent(of: DatasetContents) -> list[str]:
    """Columns that a data set might have and this one has not, with the reason."""
    missing = [name for name in (VELOCITY, EFFORT) if name not in of.features]
    found = [f"{name} (not known of every joint in every frame)" for name in missing]
    found += [] if IMU in of.features else [f"{IMU} (none, or not read all the time)"]
    if not of.has_success_marks:
        found.append("next.success (some episodes are marked neither as success nor as failure)")
    return [*found, "images (recordings have none)"]


def _lines(of: DatasetContents) -> list[str]:
    sources = list(dict.fromkeys(each.recording for each in of.episodes))
    found = ["", f"# {of.robot_type}: {', '.join(of.tasks)}", ""]
    found.append(
        f"LeRobotDataset v3.0 out of recordings of twind: {len(of.episodes)} episodes, {of.frames} frames at "
        f"{of.fps} a second, {len(of.joints)} joints."
    )
    found += ["", "| column | what |", "|---|---|"]
    found += [f"| {name} | {_MEANINGS[name]} |" for name in of.features]
    found.append("| next.done | the last frame of its episode |")
    if of.has_success_marks:
        found.append("| next.success | the last frame of an episode that was marked a success |")
    found += ["| timestamp | s since the episode's first frame |", ""]
    found.append("`meta/episodes` has besides: success (null: not marked), recording, recording_time (s).")
    found += ["", "Not in it:", *(f"- {each}" for each in absent(of))]
    found += [f"- {line(each)}" for each in of.left]
    return [*found, "", "Recordings:", *(f"- {each}" for each in (*sources, *of.damage))]
