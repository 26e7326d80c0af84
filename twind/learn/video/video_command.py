"""Draw a recording as an .mp4 video.

Reads an .mcap or .flight file. No display is needed. A robot without a fixed base stands on its lowest part,
because no sensor tells where it is. No file is overwritten.
"""

import argparse
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from twind.command_line.progress import ProgressLine
from twind.command_line.verb import DONE, Rejected, UsageError, show
from twind.config.yaml_tree import ConfigError
from twind.exceptions import InvalidInput, OperationFailed
from twind.robot.arrays import Floats

group = "record"
unused_options = ("--socket",)  # it asks no daemon


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `twindctl video`."""
    parser.add_argument("file", metavar="FILE", type=Path, help="an .mcap or .flight file")
    parser.add_argument("out", metavar="OUT.mp4", type=Path, help="the file to write")
    parser.add_argument("--fps", type=float, default=25.0, metavar="N", help="pictures per second (25)")
    parser.add_argument("--from", dest="begin", type=float, default=0.0, metavar="S", help="s from the start")
    parser.add_argument("--to", dest="end", type=float, default=inf, metavar="S", help="s from the start")
    parser.add_argument("--robot", metavar="FILE|NAME", help="the robot, where the recording holds none")


def run(options: argparse.Namespace) -> int:
    """Exit code 0: it is written. Raises UsageError, Rejected."""
    if not 1.0 <= options.fps <= 100.0:
        raise UsageError(f"--fps {options.fps:g}: 1 to 100 are possible")
    try:
        frames = _draw(options)
    except (InvalidInput, ConfigError, OperationFailed) as error:
        raise Rejected(str(error)) from None
    show(options, {"out": str(options.out), "frames": frames}, f"{options.out}: {frames} pictures")
    return DONE


def _draw(options: argparse.Namespace) -> int:
    from twind.learn.video.video_writer import VideoWriter
    from twind.observe.recording import open_recording

    recording = open_recording(options.file)
    binding = _binding(options, recording)
    measured = np.isfinite(recording.measured)
    position = np.where(measured, recording.measured, recording.simulated)
    position = np.where(np.isfinite(position), position, binding.rest)
    begin = max(options.begin, float(recording.time[0]))
    end = min(options.end, float(recording.time[-1]))
    times = np.arange(begin, end, 1.0 / options.fps)
    if not len(times):
        raise InvalidInput(
            f"{options.file}: there is nothing between {options.begin:g} and {options.end:g} s"
        )
    pose = _RecordedPose(binding, None if recording.imu is None else recording.imu.quaternion)
    writer = VideoWriter(options.out, binding.model, binding.robot.base, options.fps)
    try:
        with ProgressLine(options, "video") as progress:
            for time, row in zip(times, np.searchsorted(recording.time, times, "right") - 1, strict=True):
                writer.add(pose.placed(position[row], int(row)))
                progress.update(f"{time - begin:.0f} of {end - begin:.0f} s")
    finally:
        writer.close()
    return writer.frames


def _binding(options: argparse.Namespace, recording: Any) -> Any:
    """Return the robot that is named, else the recorded one. Raises InvalidInput, ConfigError."""
    from twind.config.robot_file import load_robot
    from twind.gap.recorded_model import recorded_binding
    from twind.twin.binding import bind

    if options.robot is None and (recording.robot is None or recording.mjcf is None):
        raise InvalidInput(f"{options.file}: it holds no robot: name it by --robot")
    if options.robot is None:
        binding = recorded_binding(recording.robot, recording.mjcf)
    else:
        binding = bind(load_robot(options.robot), None)
    if binding.robot.names != recording.joints:
        raise InvalidInput(f"its joints {', '.join(recording.joints)} are not those of the robot")
    return binding


class _RecordedPose:
    """Poses of a model from rows of a recording."""

    def __init__(self, binding: Any, quaternions: Floats | None) -> None:
        import mujoco

        from twind.twin.base_pose import touching

        self._binding = binding
        self._data = mujoco.MjData(binding.model)
        self._quaternions = quaternions
        self._geoms = touching(binding.model)
        base = binding.model.body(binding.robot.base)
        self._free = int(binding.model.jnt_qposadr[base.jntadr[0]]) if binding.floating else -1

    def placed(self, position: Floats, row: int) -> Any:
        """Return the data with these joints (n,), rad, and the base as the IMU had it at `row` or before."""
        from twind.twin.base_pose import touch_down

        data = self._data
        data.qpos[self._binding.qpos] = position
        if self._free >= 0:
            if self._quaternions is not None and np.isfinite(self._quaternions[row]).all():
                data.qpos[self._free + 3 : self._free + 7] = self._quaternions[row]
            touch_down(self._binding.model, data, self._free + 2, self._geoms)
        return data
