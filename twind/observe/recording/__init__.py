"""Recordings as columns of numbers: .mcap and .flight files. Reads files alone."""

from twind.observe.recording.recording_columns import RobotRecording, open_recording

__all__ = ["RobotRecording", "open_recording"]
