"""Recordings as columns of numbers: .mcap and .flight files. Reads files alone."""

from pathlib import Path

from twind.command_line.verb import Rejected
from twind.exceptions import InvalidInput
from twind.observe.recording.recording_columns import RobotRecording
from twind.observe.recording.unopened_file import unopened
from twind.plain_file import open_plain

__all__ = ["RobotRecording", "open_recording"]


def open_recording(path: Path | str) -> RobotRecording:
    """The recording at `path`, as far as it is readable (`damage` names what is missing).

    Raises Rejected: no such file, another kind of file, or no data of a robot.
    """
    path = Path(path)
    try:
        with open_plain(path) as file:
            head = file.read(5)
    except InvalidInput as error:
        raise Rejected(str(error)) from None
    except OSError as error:
        raise unopened(path, error) from None
    if head == b"\x89MCAP":
        from twind.observe.recording.mcap_reader import read as read_mcap

        return read_mcap(path)
    if head == b"twind":
        from twind.observe.recording.flight_reader import read as read_flight

        return read_flight(path)
    raise Rejected(f"{path}: neither an .mcap nor a .flight file, by its first bytes")
