"""Episodes cut from recordings and put on the grid, with one order of joints; omissions are reported."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from twind.command_line.verb import Rejected
from twind.learn.dataset.episode_frames import (
    ACTION,
    EFFORT,
    FELT,
    IMU,
    STATE,
    VELOCITY,
    EpisodeFrames,
    frames,
    rate,
    too_fast,
)
from twind.learn.dataset.episode_spans import EpisodeSpan, OmittedSpan, ReadingCoverage, ReadingRun, parts
from twind.observe.recording import RobotRecording, open_recording

SHORTEST = 1.0  # s: an unmarked stretch that is shorter is left out


@dataclass(frozen=True, slots=True)
class DatasetRequest:
    """Settings from which a data set is made."""

    fps: int
    task: str | None = None  # of episodes that have none
    only_success: bool = False
    robot_type: str | None = None
    gap: float = 0.1  # s: the longest without a reading inside an episode


@dataclass(frozen=True, slots=True)
class DatasetContents:
    """Everything that goes into a data set."""

    fps: int
    robot_type: str
    joints: tuple[str, ...]
    features: tuple[str, ...]  # of `EpisodeFrames.columns`, those that are known in all of them
    episodes: tuple[EpisodeFrames, ...]
    left: tuple[OmittedSpan, ...]  # what is not in it, and why
    damage: tuple[str, ...]  # of the recordings, in words

    @property
    def tasks(self) -> tuple[str, ...]:
        """Task names, each once, in the order in which they appear."""
        return tuple(dict.fromkeys(each.task for each in self.episodes))

    @property
    def frames(self) -> int:
        """Number of frames of all episodes."""
        return sum(each.count for each in self.episodes)

    def names(self, feature: str) -> tuple[str, ...]:
        """Return the names of the numbers of one of `features`: the IMU's for IMU, else the joints."""
        return FELT if feature == IMU else self.joints

    @property
    def has_success_marks(self) -> bool:
        """True where every episode is marked as a success or a failure."""
        return all(each.success is not None for each in self.episodes)

    @property
    def absent(self) -> list[str]:
        """Columns that a data set might have and this one has not, with the reason."""
        missing = [name for name in (VELOCITY, EFFORT) if name not in self.features]
        found = [f"{name} (not known of every joint in every frame)" for name in missing]
        found += [] if IMU in self.features else [f"{IMU} (none, or not read all the time)"]
        if not self.has_success_marks:
            found.append("next.success (some episodes are marked neither as success nor as failure)")
        return [*found, "images (recordings have none)"]


def gather(
    paths: Sequence[Path], asked: DatasetRequest, tell: Callable[[Path], None] = lambda path: None
) -> DatasetContents:
    """Raises Rejected: a file is unreadable or named twice, two do not go together, or nothing can be learnt.

    `tell` receives each file before it is read.
    """
    episodes: list[EpisodeFrames] = []
    left: list[OmittedSpan] = []
    damage: list[str] = []
    joints: tuple[str, ...] = ()
    robot: str | None = None
    _require_each_once(paths)
    for path in paths:
        tell(path)
        recording = open_recording(path)
        recording = _ordered(recording, joints) if joints else recording
        joints = joints or recording.joints
        robot = _robot(recording, robot, asked)
        if recording.damage:
            damage.append(f"{path.name}: {recording.damage}")
        found, lost = _episodes(recording, asked)
        episodes += found
        left += lost
    if not episodes:
        raise Rejected("\n".join(["no episode can be learnt from:", *map(line, left)]))
    wanted = (STATE, VELOCITY, EFFORT, IMU, ACTION)
    known = tuple(name for name in wanted if _has_feature(episodes, name))
    kept = tuple(replace(each, columns={name: each.columns[name] for name in known}) for each in episodes)
    return DatasetContents(asked.fps, robot or "unknown", joints, known, kept, tuple(left), tuple(damage))


def _require_each_once(paths: Sequence[Path]) -> None:
    """Raises Rejected: by two names, or by one twice, its episodes would count double."""
    seen: dict[tuple[int, int], Path] = {}
    for path in paths:
        if not path.exists():
            continue  # opening it reports that
        found = path.stat()
        place = found.st_dev, found.st_ino
        if place in seen:
            raise Rejected(f"{path}: this is the recording {seen[place]} once more: name each once")
        seen[place] = path


def line(left: OmittedSpan) -> str:
    """Return a line for people on an omitted span: recording, task, time in s and reason."""
    task = f" {left.task!r}" if left.task else ""
    return f"{left.recording}{task} at {left.time:.2f} s: {left.why}"


def _has_feature(episodes: Sequence[EpisodeFrames], feature: str) -> bool:
    return not any(np.isnan(each.columns[feature]).any() for each in episodes)


def _ordered(recording: RobotRecording, joints: tuple[str, ...]) -> RobotRecording:
    """The same with its joints in this order. Raises Rejected where they are others."""
    if recording.joints == joints:
        return recording
    other = sorted(set(recording.joints) ^ set(joints))
    if other:
        raise Rejected(
            f"{recording.path}: its joints are not those of the recordings before: {', '.join(other)} "
            "is not in both; a data set is of one robot, make two"
        )
    order = [recording.joints.index(name) for name in joints]
    slow = recording.slow
    if slow is not None:
        columns = {
            name: getattr(slow, name)[:, order] for name in ("temperature", "voltage", "torque", "age")
        }
        slow = replace(slow, **columns)
    rows = {name: getattr(recording, name)[:, order] for name in ("measured", "velocity", "effort", "goal")}
    return replace(recording, joints=joints, slow=slow, simulated=recording.simulated[:, order], **rows)


def _robot(recording: RobotRecording, before: str | None, asked: DatasetRequest) -> str | None:
    """The kind of robot. Raises Rejected where a recording is of another."""
    name = asked.robot_type or recording.meta.get("robot") or before
    if before is not None and name != before:
        raise Rejected(
            f"{recording.path}: of the robot {name}, the recordings before of {before}; "
            "where they are of one kind, name it with --robot-type"
        )
    return name


# -------------------------------------------------------------------------------------- one recording


def _episodes(
    recording: RobotRecording, asked: DatasetRequest
) -> tuple[list[EpisodeFrames], list[OmittedSpan]]:
    found: list[EpisodeFrames] = []
    meant, left = parts(recording, asked.task)
    wholeness = ReadingCoverage(recording, asked.gap)
    for part in meant:
        if not part.task:
            raise Rejected(
                f"{recording.path}: no task is known of what begins at {part.begin:.2f} s, and every episode "
                "of a data set has one; name it with --task"
            )
        if asked.only_success and not part.success:
            left.append(_make_omitted_span(recording, part, part.begin, "not marked as a success"))
            continue
        runs = wholeness.runs(part)
        left += _omitted_spans(recording, wholeness, part, runs)
        if len(runs) > 1 and recording.episodes:
            continue
        for run in runs:
            why = _unfit(recording, run, asked.fps)
            if why:
                left.append(_make_omitted_span(recording, part, float(recording.time[run.first]), why))
            else:
                found.append(frames(recording, part, run, asked.fps, asked.gap))
    return found, left


def _omitted_spans(
    recording: RobotRecording, wholeness: ReadingCoverage, part: EpisodeSpan, runs: Sequence[ReadingRun]
) -> list[OmittedSpan]:
    """Return the spans of a part in no stretch; a marked episode with a hole is lost whole."""
    time = recording.time
    found = []
    if not runs:
        return [_make_omitted_span(recording, part, *wholeness.hole(part))]
    if len(runs) > 1 and recording.episodes:
        at, why = wholeness.hole(part, runs[0].last)
        return [
            _make_omitted_span(
                recording, part, at, f"left out, it has {len(runs) - 1} holes; of the first: {why}"
            )
        ]
    if time[runs[0].first] - part.begin > SHORTEST:
        gone = f"its first {time[runs[0].first] - part.begin:.1f} s"
        found.append(
            _make_omitted_span(
                recording, part, part.begin, f"{gone} are not in it: {wholeness.hole(part)[1]}"
            )
        )
    for run, after in zip(runs, [*runs[1:], None], strict=True):
        until = part.end if after is None else float(time[after.first])
        at, why = wholeness.hole(part, run.last)
        if after is not None:
            found.append(
                _make_omitted_span(recording, part, at, f"a hole of {until - time[run.last]:.2f} s: {why}")
            )
        elif until - time[run.last] > SHORTEST:
            found.append(
                _make_omitted_span(recording, part, at, f"its last {until - time[run.last]:.1f} s: {why}")
            )
    return found


def _unfit(recording: RobotRecording, run: ReadingRun, fps: int) -> str:
    """Return the reason why a stretch is no episode; empty: it is one."""
    seconds = recording.time[run.last] - recording.time[run.first]
    shortest = 1.0 / fps if recording.episodes else SHORTEST
    if seconds < shortest:
        return f"a stretch of {seconds:.2f} s, shorter than {shortest:g} s"
    if too_fast(recording, run, fps):
        most = int(rate(recording, run))
        return f"{fps} frames a second of {most} readings a second: --fps at most {most}"
    return ""


def _make_omitted_span(recording: RobotRecording, part: EpisodeSpan, time: float, why: str) -> OmittedSpan:
    return OmittedSpan(recording.path.name, part.task, time, why)
