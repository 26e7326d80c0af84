"""Trajectory files: found by path or by name, read strictly, in the shape that the socket takes; and written.

Files have the shape of a ROS trajectory message; `time_from_start` may be seconds or {sec, nanosec}.
"""

import contextlib
import json
import os
import re
from collections.abc import Collection, Mapping
from difflib import get_close_matches
from importlib import resources
from pathlib import Path
from typing import Any

from twind.command_line.verb import Rejected, UsageError
from twind.exceptions import InvalidInput
from twind.new_file import open_new
from twind.plain_file import read_plain
from twind.protocol.strict_json import loads

LARGEST = 4 << 20  # bytes
_NAME = re.compile(r"[A-Za-z0-9_-]{1,64}")
_UNUSED = ("header",)  # of a ROS message, and nothing that changes a motion


def motion_names(folder: Path | None = None) -> tuple[str, ...]:
    """Names of the motions in `folder`, or of those of the built-in robot."""
    return tuple(sorted(path.stem for path in (folder or _built_in()).glob("*.json")))


def load_motion(
    name: str, folder: Path | None = None, joints: Collection[str] | None = None
) -> dict[str, Any]:
    """The trajectory of a file, or of the motion called `name` in `folder` or beside the built-in robot.

    Raises UsageError when there is none, with the names of the motions in `folder` and of those built-in ones
    that move only `joints` (None: any); Rejected when it is no trajectory.
    """
    return read_trajectory(_find(name, folder, joints))


def read_trajectory(path: Path) -> dict[str, object]:
    """A trajectory file as a `Trajectory` of the interface. Raises UsageError, Rejected with the place."""
    try:
        data = read_plain(path, LARGEST)
    except InvalidInput as error:
        raise Rejected(str(error)) from None
    except (OSError, ValueError) as error:
        raise UsageError(f"{path}: {getattr(error, 'strerror', None) or error}") from None
    try:
        message = loads(data)
    except InvalidInput as error:
        raise Rejected(f"{path}{_place(data, error.position)}: {error}") from None
    if not isinstance(message, dict) or not isinstance(message.get("points"), list):
        raise Rejected(f"{path}: expected an object with joint_names and points")
    points = [_point(point, f"{path}: points[{place}]") for place, point in enumerate(message["points"])]
    return {key: value for key, value in message.items() if key not in _UNUSED} | {"points": points}


def new_motion(name: str, folder: Path | None) -> Path:
    """The path of a motion to write: `name` is a path, or a name in `folder` (None: there is none).

    Raises UsageError: no name, or no folder to write it into.
    """
    if os.sep in name or name.endswith(".json"):
        return Path(name)
    if not _NAME.fullmatch(name):
        raise UsageError(f"{name!r} is no name of a motion: use 1 to 64 letters, digits, _ and -")
    if folder is None or folder == _built_in():
        raise UsageError(f"{name}: a built-in robot takes no motions: give a path, as ./{name}.json")
    return folder / f"{name}.json"


def write_trajectory(path: Path, trajectory: Mapping[str, Any], *, replace: bool) -> None:
    """Write a trajectory file, a point a line: whole or not at all, and on the disk on return.

    Makes its folder where only that is missing. Raises FileExistsError unless `replace`; OSError.
    """
    points = ",\n".join(f"    {json.dumps(point, allow_nan=False)}" for point in trajectory["points"])
    names = json.dumps(trajectory["joint_names"])
    text = f'{{\n  "joint_names": {names},\n  "points": [\n{points}\n  ]\n}}\n'
    path.parent.mkdir(exist_ok=True)
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    fresh = f".{path.name}.{os.getpid()}"
    try:
        _write(folder, fresh, text.encode())
        # Unlike a rename, a link never takes the place of another file.
        (os.replace if replace else os.link)(fresh, path.name, src_dir_fd=folder, dst_dir_fd=folder)
        os.fsync(folder)
    finally:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(fresh, dir_fd=folder)
        os.close(folder)


def _write(folder: int, name: str, data: bytes) -> None:
    with open(open_new(name, 0o644, folder), "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def _point(point: Any, where: str) -> dict[str, object]:
    """One point: time in seconds, empty columns left out as ROS means them."""
    if not isinstance(point, dict) or "time_from_start" not in point:
        raise Rejected(f"{where}: expected an object with positions and time_from_start")
    optional = ("velocities", "accelerations", "effort")
    kept = {key: value for key, value in point.items() if not (key in optional and value == [])}
    kept["time_from_start"] = _seconds(point["time_from_start"], where)
    return kept


def _seconds(value: Any, where: str) -> Any:
    """Seconds, from a number or {sec, nanosec}."""
    if not isinstance(value, dict):
        return value  # a number, or for the daemon to refuse
    if value.keys() - {"sec", "nanosec"} or not all(type(part) is int for part in value.values()):
        raise Rejected(f"{where}.time_from_start: expected seconds, or whole sec and nanosec; got {value}")
    return value.get("sec", 0) + value.get("nanosec", 0) * 1e-9


def _find(name: str, folder: Path | None, joints: Collection[str] | None) -> Path:
    if os.sep in name or name.endswith(".json") or Path(name).is_file():
        return Path(name)
    folders = [*([folder] if folder is not None else []), _built_in()]
    for place in folders:
        if (place / f"{name}.json").is_file():
            return place / f"{name}.json"
    known = {*(motion_names(folder) if folder is not None else ()), *_built_in_motions(joints)}
    where = "" if folder is None else f" in {folder} of the robot, nor a built-in one that fits it"
    listed = f"known: {', '.join(sorted(known))}; or" if known else "the robot has none;"
    near = get_close_matches(name, known, 1)
    listed = f"nearest: {near[0]}; {listed}" if near else listed
    raise UsageError(f"no motion {name!r}{where}; {listed} give the path of a file")


def _built_in_motions(joints: Collection[str] | None) -> tuple[str, ...]:
    """Names of the built-in motions that move only `joints`; None: of all."""
    if joints is None:
        return motion_names()
    return tuple(name for name in motion_names() if set(load_motion(name)["joint_names"]) <= set(joints))


def _built_in() -> Path:
    return Path(str(resources.files("twind.robots"))) / "motions"


def _place(data: bytes, position: int | None) -> str:
    """`:line:column` of a character."""
    if position is None:
        return ""
    before = data.decode("utf-8", "replace")[:position]
    return f":{before.count(chr(10)) + 1}:{position - before.rfind(chr(10))}"
