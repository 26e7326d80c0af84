"""The folder of a training: settings and figures, the checkpoint, policies, the curve. One training
at a time.

Every file is written whole beside its name, synced, and renamed: a process that is killed at any moment
leaves the checkpoint before or the one after, never half of one.
"""

import fcntl
import json
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from twind.command_line.verb import Rejected
from twind.learn.training.training_settings import TrainingSettings, settings_from_json
from twind.new_file import write_new

FORMAT = "twind-run/1"
RUN = "run.json"
CHECKPOINT = "checkpoint.pt"
CURVE = "curve.png"
BEST = "policy.onnx"
LAST = "last.onnx"
CANDIDATE = "candidate.onnx"
_LOCK = ".lock"


@dataclass(frozen=True, slots=True)
class TrainingFolder:
    """A folder that is ours (`taken`)."""

    path: Path

    def write(self, name: str, data: bytes) -> Path:
        """`name` holds `data`, or what it held. Raises OSError."""
        return self.make(name, lambda beside: write_new(beside, data))

    def make(self, name: str, write: Callable[[Path], object]) -> Path:
        """`name` is what `write` makes at the path that it is given, or stays what it was. Raises OSError."""
        beside = self.path / f".{name}.new"
        place = self.path / name
        try:
            write(beside)
            with beside.open("rb") as file:
                os.fsync(file.fileno())
            beside.replace(place)
        finally:
            beside.unlink(missing_ok=True)
        directory = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(directory)
        finally:
            os.close(directory)
        return place

    def write_run(self, settings: TrainingSettings, more: Mapping[str, object]) -> None:
        """Write the settings of the run and its results so far. Raises OSError."""
        data = {"format": FORMAT, "settings": settings.to_json(), **more}
        self.write(RUN, (json.dumps(data, indent=1, ensure_ascii=False) + "\n").encode())


@contextmanager
def lock_folder(path: Path) -> Iterator[TrainingFolder]:
    """The folder, made where there was none, for us alone; gone again where nothing came into it.

    Raises Rejected: another process trains there.
    """
    made = not path.exists()
    try:
        path.mkdir(parents=True, exist_ok=True)
        lock = os.open(path / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o644)
    except OSError as error:
        raise Rejected(f"{path}: {error.strerror or error}") from None
    try:
        _lock(lock, path)
        yield TrainingFolder(path)
    finally:
        if made and path.is_dir() and os.listdir(path) == [_LOCK]:
            (path / _LOCK).unlink()
            path.rmdir()
        os.close(lock)


def _lock(lock: int, path: Path) -> None:
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        who = os.pread(lock, 32, 0).decode(errors="replace").strip() or "unknown"
        raise Rejected(
            f"{path}: a training is running there (process {who}); stop it, or name another folder"
        ) from None
    os.ftruncate(lock, 0)
    os.pwrite(lock, f"{os.getpid()}\n".encode(), 0)


def require_fresh(path: Path) -> None:
    """Raises Rejected: something is in it that a new training would write over."""
    for name in (RUN, CHECKPOINT, BEST, LAST, CURVE):
        if (path / name).exists():
            remedy = f"--resume {path} goes on with it" if name == RUN else "name another folder with --out"
            raise Rejected(f"{path}: there is a {name} already; {remedy}")


def read_run(path: Path) -> tuple[TrainingSettings, dict[str, object]]:
    """Settings and figures of the run in a folder. Raises Rejected naming the file and what is wrong."""
    file = path / RUN
    try:
        data = json.loads(file.read_text())
        if not isinstance(data, dict) or data.get("format") != FORMAT:
            raise ValueError(f"is no {FORMAT}")
        return settings_from_json(data["settings"]), data
    except OSError as error:
        raise Rejected(f"{file}: {error.strerror or error}; no training began there") from None
    except (ValueError, KeyError, TypeError) as error:
        raise Rejected(f"{file}: {error}") from None
