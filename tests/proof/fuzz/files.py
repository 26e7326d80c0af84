"""Robot and calibration files that nobody should write: a ConfigError that says where, in bounded time."""

import shutil
import tempfile
import time
from pathlib import Path
from random import Random

from tests.proof.fuzz.mangle import mangled
from tests.support.h24_calibration import ROBOT, TEXT, rehashed
from tests.support.small_robot_file import SMALL
from twind.config.calibration_file import read_calibration
from twind.config.robot_file import load_robot, read_robot
from twind.config.yaml_tree import ConfigError

LONGEST = 2.0  # s of CPU for one file
VALUES = (
    *(".nan", "-.inf", "1e3", "1e999", "010", "0x10", "12:30", "no", "~", "''", "'1'", "2026-01-01", "1_000"),
    *("-1", "0", "99999999999999999999", "!!python/object/apply:os.system [ls]", "!!binary aGk=", "!x 1"),
    *(
        "&a 1",
        "*a",
        "<<: *a",
        "[1, 2",
        "{a: b",
        "{a: 1, a: 2}",
        "[]",
        "{}",
        "'\\ud800'",
        '"\\ud800"',
        "|\n  x",
    ),
    *("\t", "%YAML 2.0", "--- a", "... b", "\x00", "é", "\ufeff", "a: b: c", "? x", "- - -", "[[[[1]]]]"),
)
BOMBS = (
    "a: &a [x, x]\nb: &b [*a, *a]\nc: &c [*b, *b]\n",
    "[" * 3000,
    "{a: " * 2000,
    "- " * 2000,
    "a:\n" + "".join(" " * depth + "b:\n" for depth in range(1, 1500)),
    "k: v\n" * 20_000,
    "x" * 300_000,
    "'" + "y" * 200_000,
    "? " * 1000,
    "&a [*a]",
    "--- 1\n--- 2\n",
)


class Files:
    """Writes and reads mutated files in a folder of its own."""

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="twind-fuzz-"))
        shutil.copy(load_robot("h24").mjcf_path, self.folder / "arm.xml")
        self.accepted = 0

    def finish(self) -> str:
        """Number of accepted inputs."""
        return f"{self.accepted} accepted"

    def close(self) -> None:
        """Remove the folder."""
        shutil.rmtree(self.folder)

    def one(self, rng: Random) -> None:
        """One input. Raises whatever is wrong."""
        robot = rng.random() < 0.6
        data = _mutated(rng, SMALL if robot else _short(rng))
        if not robot and rng.random() < 0.7:
            data = _resigned(data)
        begun = time.process_time()
        refused = None
        try:
            self._read(data, robot=robot)
        except ConfigError as error:
            refused = str(error)
        assert refused != "", "refused without a word"
        self.accepted += refused is None
        took = time.process_time() - begun
        assert took < LONGEST, f"{took:.1f} s for {len(data)} bytes"

    def _read(self, data: bytes, *, robot: bool) -> None:
        if robot:
            path = self.folder / "arm-2.yaml"
            path.write_bytes(data)
            read_robot(path)
        else:
            read_calibration(data.decode("utf-8", "surrogateescape"), "fuzz", ROBOT)


def _short(rng: Random) -> str:
    """The calibration whole now and then (it is long), its first lines otherwise."""
    return TEXT if rng.random() < 0.2 else "\n".join(TEXT.split("\n")[:40])


def _resigned(data: bytes) -> bytes:
    """With a hash that fits, so that what stands behind it is read."""
    try:
        return rehashed(data.decode()).encode()
    except (UnicodeDecodeError, ValueError):
        return data


def _mutated(rng: Random, text: str) -> bytes:
    kind = rng.randrange(10)
    if kind == 0:
        return rng.randbytes(rng.randrange(400))
    if kind == 1:
        return (text[: rng.randrange(len(text))] + rng.choice(BOMBS)).encode()
    if kind <= 3:
        return mangled(rng, text.encode(), rng.randrange(1, 8))
    lines = text.split("\n")
    for _ in range(rng.choice((1, 1, 2, 6))):
        _change(rng, lines)
    return "\n".join(lines).encode("utf-8", "surrogatepass")


def _change(rng: Random, lines: list[str]) -> None:
    """One line of YAML, changed as a person or a program might change it."""
    at = rng.randrange(len(lines))
    key, colon, value = lines[at].partition(":")
    kind = rng.randrange(8)
    if kind <= 2 and colon:
        lines[at] = f"{key}: {rng.choice(VALUES)}"
    elif kind == 3 and value:  # one of the numbers or words in it
        words = value.split(" ")
        words[rng.randrange(len(words))] = rng.choice(VALUES)
        lines[at] = f"{key}:{' '.join(words)}"
    elif kind == 4:
        lines.insert(at, lines[at])
    elif kind == 5:
        del lines[at]
        lines.append("")
    elif kind == 6:
        other = rng.randrange(len(lines))
        lines[at], lines[other] = lines[other], lines[at]
    else:
        lines[at] = " " * rng.randrange(5) + lines[at] + rng.choice(("", " #", "\t", "  x"))
