"""Files that must be old or new, never mixed: written beside, synced, read back, renamed, folder synced.

One program at a time saves into a folder. A program that derives a file from its present contents reads it
`alone` as well.
"""

import contextlib
import errno
import fcntl
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from twind.config.config_reader import file_error
from twind.new_file import open_new
from twind_drivers.clock import MonotonicClock

PATIENCE = 30.0  # s to wait for another program that saves there
PAUSE = 0.02  # s between two looks

# A dot is followed by no digit: numbered history is NAME.0001.yaml.
_NAME = re.compile(r"(?=.{1,64}$)[a-z0-9_-]+(\.[a-z_-][a-z0-9_-]*)*")


@dataclass(frozen=True, slots=True)
class FileOwnership:
    """Mode, owner and group of a file, set before it gets its name."""

    mode: int = 0o640
    owner: int = -1  # -1: who writes it
    group: int = -1


@dataclass(frozen=True, slots=True)
class LockedFolder:
    """A folder into which no other program saves (`alone`)."""

    path: Path
    _directory: int  # its descriptor, locked

    def save_text(self, name: str, text: str, history: int, rights: FileOwnership | None = None) -> Path:
        """Make `name.yaml` hold `text`; the earlier one becomes `name.0001.yaml` and up, `history` kept.

        A power cut at any point leaves the old or the new file, and none of the earlier ones less, but for
        the oldest beyond `history` once the new one is safe. `rights` None: mode 0640, less what the umask
        takes. Raises ConfigError (a name that is not 1 to 64 of a-z 0-9 _ -, with dots before letters; bytes
        that read back differently), OSError (disk full, no permission): then the old file stands, whatever is
        beside it.
        """
        require_name(self.path, name)
        current = f"{name}.yaml"
        fresh = f".{name}.yaml.new"
        _write(self._directory, fresh, text.encode(), rights)
        _keep(self._directory, name, current)
        _rename(self._directory, fresh, current)
        for number in _numbers(self._directory, name)[:-history]:
            os.unlink(_numbered(name, number), dir_fd=self._directory)
        return self.path / current

    def save_draft(self, name: str, text: str, rights: FileOwnership | None = None) -> Path:
        """Make the draft of `name.yaml` hold `text`: old or new, never mixed, and no history.

        Raises as `save_text`.
        """
        require_name(self.path, name)
        path = draft_of(self.path, name)
        fresh = f"{path.name}.new"
        _write(self._directory, fresh, text.encode(), rights)
        _rename(self._directory, fresh, path.name)
        return path


@contextlib.contextmanager
def lock_folder(folder: Path) -> Iterator[LockedFolder]:
    """Lock a folder: other programs that save there wait. One program must not hold it twice.

    Raises OSError: no folder, no permission to read it, another program saves there for half a minute.
    """
    directory = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        _lock(directory)
        yield LockedFolder(folder, directory)
    finally:
        os.close(directory)


def save_text(folder: Path, name: str, text: str, history: int, rights: FileOwnership | None = None) -> Path:
    """`LockedFolder.save_text`, of a text independent of the present file. Raises as it and as `alone`."""
    with lock_folder(folder) as held:
        return held.save_text(name, text, history, rights)


def draft_of(folder: Path, name: str) -> Path:
    """Return the path of the draft of `folder/name.yaml`."""
    return folder / f".{name}.draft.yaml"


def _lock(directory: int) -> None:
    """Take the lock. It belongs to the descriptor, so that a killed program leaves none behind."""
    clock = MonotonicClock()
    deadline = clock.now() + PATIENCE
    while True:
        try:
            fcntl.flock(directory, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        except BlockingIOError:
            if clock.now() > deadline:
                why = f"another program saves there, for {PATIENCE:g} s now; is it stopped (Ctrl-Z)?"
                raise BlockingIOError(errno.EAGAIN, why) from None
        clock.sleep_until(clock.now() + PAUSE)


def require_name(folder: Path, name: str) -> None:
    """Require a name under which `save_text` saves. Raises ConfigError."""
    if not _NAME.fullmatch(name):
        raise file_error(
            str(folder),
            f"{name!r} is no name for a file: use 1 to 64 of a-z, 0-9, _ and -, with dots before letters",
        )


def _write(directory: int, name: str, data: bytes, rights: FileOwnership | None) -> None:
    """A file with `data`, on the disk and read back. What a power cut left behind is removed."""
    fd = open_new(name, 0o640, directory)
    try:
        view = memoryview(data)
        while view:
            view = view[os.write(fd, view) :]
        if rights is not None:
            os.fchmod(fd, rights.mode)
            os.fchown(fd, rights.owner, rights.group)
        os.fsync(fd)
        if os.pread(fd, len(data) + 1, 0) != data:
            raise file_error(name, "reads back other than it was written: check the disk")
    except BaseException:
        with contextlib.suppress(OSError):  # on a full disk its room is needed
            os.unlink(name, dir_fd=directory)
        raise
    finally:
        os.close(fd)


def _rename(directory: int, fresh: str, name: str) -> None:
    os.replace(fresh, name, src_dir_fd=directory, dst_dir_fd=directory)
    os.fsync(directory)


def _keep(directory: int, name: str, current: str) -> None:
    """A second name for the current file, on the disk before it loses its first."""
    target = _numbered(name, max(_numbers(directory, name), default=0) + 1)
    try:
        os.link(current, target, src_dir_fd=directory, dst_dir_fd=directory, follow_symlinks=False)
    except FileNotFoundError:
        return  # the first one ever
    os.fsync(directory)


def _numbered(name: str, number: int) -> str:
    return f"{name}.{number:04d}.yaml"


def _numbers(directory: int, name: str) -> list[int]:
    """Return the numbers of the earlier files of `name`, the oldest first."""
    form = re.compile(re.escape(name) + r"\.(\d{4,9})\.yaml")
    return sorted(int(found[1]) for entry in os.listdir(directory) if (found := form.fullmatch(entry)))
