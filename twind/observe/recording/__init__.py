"""Recordings as columns of numbers: .mcap and .flight files. Reads files alone."""

from twind.observe.recording.columns import Recording, open_recording

__all__ = ["Recording", "open_recording"]
