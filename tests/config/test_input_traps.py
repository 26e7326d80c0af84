"""One table of traps, walked through every door by which a file or a message comes in."""

import os
import shutil
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from twind.command_line.trajectory_files import LARGEST, read_trajectory
from twind.command_line.verb import Rejected, UsageError
from twind.config.calibration_file import dump_calibration, load_calibration, text_hash
from twind.config.daemon_settings import load_settings
from twind.config.robot_file import RobotFile, load_robot, read_robot
from twind.config.yaml_tree import MAX_BYTES, ConfigError
from twind.exceptions import InvalidInput
from twind.plain_file import read_plain
from twind.protocol import CONTROL, load
from twind.protocol.strict_json import loads
from twind.virtual.virtual_robot_spec import calibration, make_spec

H24 = load_robot("h24")


# --------------------------------------------------------------------------- the doors


class Door:
    """A kind of YAML file: a sound text of it, where a number stands in it, and who reads it."""

    def __init__(self, text: str, number: str, read: Callable[[Path], Any]) -> None:
        self.text = text
        self.number = number
        self.read = read
        assert text.count(number) == 1, (number, text.count(number))

    def with_number(self, value: str) -> str:
        """The sound text with another scalar where a number belongs."""
        key = self.number.partition(":")[0]
        return self.text.replace(self.number, f"{key}: {value}")


def robot_file(path: Path) -> RobotFile:
    shutil.copy(H24.mjcf_path, path.parent)
    return read_robot(path)


def calibration_file(path: Path) -> Any:
    """Whoever breaks a calibration may well know how to hash it."""
    data = path.read_bytes() if path.is_file() and path.stat().st_size <= MAX_BYTES else b""
    if b"sha256:" in data:
        text = data.decode("utf-8", "surrogateescape")
        stated = text.rpartition('\nsha256: "')[2][:64]
        hashed = text_hash(text.encode("utf-8", "surrogateescape").decode("utf-8", "replace"))
        path.write_bytes(text.replace(stated, hashed).encode("utf-8", "surrogateescape"))
    return load_calibration(path, H24)


DOORS = {
    "robot": Door(H24.path.read_text(), "rate_hz: 100", robot_file),
    "calibration": Door(
        dump_calibration(calibration(make_spec(H24))).replace("captures: 1\n", "captures: 7\n", 1),
        "captures: 7",
        calibration_file,
    ),
    "settings": Door("mode: mirror\nrate_hz: 100\n", "rate_hz: 100", lambda path: load_settings(path, {}, 0)),
}
EACH = pytest.mark.parametrize("door", DOORS.values(), ids=DOORS)


@EACH
def test_the_sound_text_is_read(door: Door, tmp_path: Path) -> None:
    file = tmp_path / "file.yaml"
    file.write_text(door.text)
    door.read(file)


def refused(door: Door, tmp_path: Path, data: bytes | str) -> str:
    """Why the file is refused."""
    file = tmp_path / "file.yaml"
    file.write_bytes(data if isinstance(data, bytes) else data.encode())
    try:
        door.read(file)
    except ConfigError as refusal:
        error = str(refusal)
    else:
        pytest.fail(f"accepted: {data[-200:]!r}")
    assert str(file) in error
    assert len(error) < 1000
    return error


# --------------------------------------------------------------------------- YAML


NO_PLAIN_NUMBERS = (
    *("no", "yes", "off", "On", "true", "TRUE"),  # a truth value is no number
    *("010", "0o10", "0x64", "0b1100100", "1_00", "12:30", "1:40.0", "1e2", "1E2", "100.e0", "1.0e+400"),
    *(".nan", ".NaN", ".inf", "-.inf", "nan", "inf", "NaN", "Infinity"),
    *("'100'", '"100"', "~", "null", "", "[100]", "{a: 100}", "2026-11-22", "=", "1" * 400),
    *("&a 100", "*a", "!!int 100", "!!int '100'", "!!float 100", "! 100", "!!python/name:os.system ''"),
)


@EACH
def test_a_value_that_is_no_plain_number_is_refused(door: Door, tmp_path: Path) -> None:
    for value in NO_PLAIN_NUMBERS:
        refused(door, tmp_path, door.with_number(value))


LAUGHS = "".join(f"l{n}: &l{n} [{', '.join([f'*l{n - 1}'] * 9) if n else 'x'}]\n" for n in range(9))
SHAPES: dict[str, tuple[Callable[[str], str | bytes], str]] = {
    "a key twice": (lambda text: text + text.splitlines()[1] + "\n", ""),
    "an anchor": (lambda text: text + "x: &y 1\n", "anchor"),
    "an alias": (lambda text: text + "x: *y\n", "alias"),
    "an alias of itself": (lambda text: text + "x: &y [*y]\n", "anchor"),
    "a billion laughs": (lambda text: LAUGHS + text, "anchor"),
    "a merge": (lambda text: text + "<<: {x: 1}\n", "merge"),
    "a tag": (lambda text: text + "x: !!binary aGk=\n", "tag"),
    "an object": (lambda text: text + "x: !!python/object/apply:os.system ['true']\n", "tag"),
    "an unknown key": (lambda text: text + "x: 1\n", "unknown key"),
    "a second document": (lambda text: text + "---\nx: 1\n", "second document"),
    "a directive": (lambda text: "%YAML 1.2\n---\n" + text, "directive"),
    "a tab": (lambda text: text + "x:\n\ty: 1\n", "not YAML"),
    "a NUL": (lambda text: text + "x: \0\n", "not YAML"),
    "depth": (lambda text: text + "x: " + "[" * 2000 + "]" * 2000 + "\n", "nested"),
    "depth of mappings": (lambda text: text + "x: " + "{a: " * 2000 + "1" + "}" * 2000 + "\n", "nested"),
    "depth of lines": (lambda text: text + "".join(" " * n + "x:\n" for n in range(300)), "nested"),
    "an open bracket": (lambda text: text + "x: " + "[" * 100_000, "nested"),
    "size": (lambda text: text + "#" * (MAX_BYTES - len(text.encode()) + 1), "larger"),
    "a byte order mark": (lambda text: "\ufeff" + text, "byte order mark"),
    "UTF-16": (lambda text: text.encode("utf-16"), "UTF-8"),
    "Latin-1": (lambda text: text.encode() + b"# \xe9\n", "UTF-8"),
    "a surrogate": (lambda text: text.encode() + b"# \xed\xa0\x80\n", "UTF-8"),
    "an overlong byte": (lambda text: text.encode() + b"# \xc0\xaf\n", "UTF-8"),
    "nothing": (lambda text: "", ""),
    "a list": (lambda text: "- 1\n", "mapping"),
}


@EACH
@pytest.mark.parametrize("shape", SHAPES)
def test_a_shape_that_two_readers_could_take_for_two_things_is_refused(
    door: Door, tmp_path: Path, shape: str
) -> None:
    make, why = SHAPES[shape]
    assert why in refused(door, tmp_path, make(door.text))


@EACH
def test_a_file_of_the_largest_size_is_read(door: Door, tmp_path: Path) -> None:
    file = tmp_path / "file.yaml"
    file.write_text("#" * (MAX_BYTES - len(door.text.encode()) - 1) + "\n" + door.text)
    assert file.stat().st_size == MAX_BYTES
    door.read(file)


# --------------------------------------------------------------------------- what stands in a file's place


def fifo(path: Path) -> None:
    os.mkfifo(path)


def folder(path: Path) -> None:
    path.mkdir()


def bound(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))


def link_to(target: str) -> Callable[[Path], None]:
    return lambda path: path.symlink_to(target)


PLACES: dict[str, Callable[[Path], None]] = {
    "a pipe": fifo,
    "a folder": folder,
    "a socket": bound,
    "an endless device": link_to("/dev/zero"),
    "an empty device": link_to("/dev/null"),
    "a terminal": link_to("/dev/ptmx"),
    "a link to itself": link_to("file.yaml"),
    "nothing": lambda path: None,
}


@EACH
@pytest.mark.parametrize("place", PLACES)
def test_a_path_that_is_no_regular_file_is_refused_without_waiting(
    door: Door, tmp_path: Path, place: str
) -> None:
    file = tmp_path / "file.yaml"
    PLACES[place](file)
    with pytest.raises(ConfigError) as error:
        door.read(file)
    assert str(file) in str(error.value)


@pytest.mark.parametrize("place", PLACES)
def test_a_motion_that_is_no_file_is_refused_and_never_waited_for(tmp_path: Path, place: str) -> None:
    file = tmp_path / "file.yaml"
    PLACES[place](file)
    with pytest.raises((Rejected, UsageError)) as error:
        read_trajectory(file)
    assert str(file) in str(error.value)


@pytest.mark.parametrize("place", ["a pipe", "a folder", "an endless device"])
def test_a_model_that_is_no_file_is_refused_at_its_key(tmp_path: Path, place: str) -> None:
    (tmp_path / "robot.yaml").write_text(H24.path.read_text().replace("h24.xml", "file.yaml"))
    PLACES[place](tmp_path / "file.yaml")
    with pytest.raises(ConfigError, match=r"model\.mjcf"):
        read_robot(tmp_path / "robot.yaml")


@pytest.mark.parametrize("name", ["a\0b", "\0"])
def test_a_path_with_a_nul_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match="null byte"):
        read_plain(Path(name), 10)
    with pytest.raises(ConfigError):
        load_settings(Path(name), {}, 0)
    with pytest.raises((Rejected, UsageError)):
        read_trajectory(Path(name))


# --------------------------------------------------------------------------- JSON

POINT = '{"positions": [%s], "time_from_start": 1.0}'
MOTION = '{"joint_names": ["head_yaw"], "points": [%s]}'
JSON: dict[str, bytes] = {
    "NaN": (MOTION % POINT % "NaN").encode(),
    "Infinity": (MOTION % POINT % "-Infinity").encode(),
    "beyond a double": (MOTION % POINT % "1e999").encode(),
    "beyond a double by digits": (MOTION % POINT % ("9" * 400 + ".0")).encode(),
    "beyond 64 bits": (MOTION % POINT % "18446744073709551616").encode(),
    "below 64 bits": (MOTION % POINT % "-9223372036854775809").encode(),
    "endless digits": (MOTION % POINT % ("1" * 100_000)).encode(),
    "octal": (MOTION % POINT % "010").encode(),
    "hexadecimal": (MOTION % POINT % "0x10").encode(),
    "base 60": (MOTION % POINT % "12:30").encode(),
    "a plus": (MOTION % POINT % "+1").encode(),
    "half a number": (MOTION % POINT % ".5").encode(),
    "a key twice": b'{"joint_names": [], "points": [], "points": []}',
    "a key twice inside": (MOTION % '{"positions": [0], "positions": [1], "time_from_start": 1}').encode(),
    "a key twice by an escape": b'{"points": [], "p\\u006fints": [], "joint_names": []}',
    "depth": b'{"points": ' + b"[" * 100_000 + b"]" * 100_000 + b"}",
    "seventeen deep": b"[" * 17 + b"]" * 17,
    "depth of objects": b'{"a":' * 50_000 + b"1" + b"}" * 50_000,
    "a comment": b'{"points": [] /* none */, "joint_names": []}',
    "a comma": b'{"points": [], "joint_names": [],}',
    "single quotes": b"{'points': [], 'joint_names': []}",
    "a byte order mark": b"\xef\xbb\xbf" + (MOTION % "").encode(),
    "UTF-16": (MOTION % "").encode("utf-16"),
    "Latin-1": b'{"joint_names": ["\xe9"], "points": []}',
    "half a pair": b'{"joint_names": ["\\ud800"], "points": []}',
    "a raw control character": b'{"joint_names": ["\x01"], "points": []}',
    "two": b"{} {}",
    "nothing": b"",
    "spaces": b"   \n ",
}


@pytest.mark.parametrize("trap", JSON)
def test_a_message_with_a_trap_is_refused(trap: str) -> None:
    with pytest.raises(InvalidInput) as error:
        loads(JSON[trap])
    assert len(str(error.value)) < 200


@pytest.mark.parametrize("trap", JSON)
def test_a_motion_file_with_a_trap_is_refused(tmp_path: Path, trap: str) -> None:
    file = tmp_path / "motion.json"
    file.write_bytes(JSON[trap])
    with pytest.raises(Rejected) as error:
        read_trajectory(file)
    assert str(file) in str(error.value)


def test_a_motion_file_beyond_its_size_is_refused_unread(tmp_path: Path) -> None:
    file = tmp_path / "motion.json"
    with file.open("wb") as motion:
        motion.truncate(LARGEST + 1)
    with pytest.raises(Rejected, match="larger"):
        read_trajectory(file)
    with file.open("wb") as motion:
        motion.truncate(1 << 40)  # nobody may read that much to find out
    with pytest.raises(Rejected, match="larger"):
        read_trajectory(file)


# --------------------------------------------------------------------------- a truth value is no number

CALLS: dict[str, dict[str, Any]] = {
    "Monitor": {"topics": ["state"], "rate": 1.0},
    "Setpoint": {"joint_names": ["a"], "positions": [0.0], "velocities": [0.0], "valid_for": 0.1},
    "SubmitTrajectory": {
        "trajectory": {
            "joint_names": ["a"],
            "points": [
                {"positions": [0.0], "velocities": [0.0], "accelerations": [0.0], "time_from_start": 1.0}
            ],
            "start_in": 0.0,
            "goal_time": 1.0,
            "tolerances": [{"joint": "a", "path": 0.1, "goal": 0.1}],
        }
    },
    "ReadRegister": {"bus": "main", "id": 1, "name": "x"},
    "WriteRegister": {"bus": "main", "id": 1, "name": "x", "value": 1},
    "Reboot": {"bus": "main", "id": 1},
}


def numbers(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths of the numbers in a call."""
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        return [found for key, item in items for found in numbers(item, (*path, key))]
    return [path] if isinstance(value, int | float) else []


def changed(value: Any, path: tuple[Any, ...], new: Any) -> Any:
    """A copy with one value in another's place."""
    if not path:
        return new
    if isinstance(value, dict):
        return {key: changed(item, path[1:], new) if key == path[0] else item for key, item in value.items()}
    return [changed(item, path[1:], new) if place == path[0] else item for place, item in enumerate(value)]


@pytest.mark.parametrize("method", CALLS)
def test_no_number_of_a_call_takes_anything_else(method: str) -> None:
    check = load(CONTROL).methods[method].parameters.check
    check(CALLS[method], "")
    places = numbers(CALLS[method])
    assert places
    for place in places:
        for wrong in (True, False, "1", [1], {"a": 1}, "NaN", "1e3"):
            with pytest.raises(Exception, match="expected") as error:
                check(changed(CALLS[method], place, wrong), "")
            assert type(error.value).__name__ == "InvalidInput"
