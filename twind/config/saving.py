"""Files that must be old or new, never mixed: written beside, synced, read back, renamed, folder synced."""

import os
import re
from dataclasses import dataclass
from pathlib import Path

from twind.config.section import file_error

_NAME = re.compile(r"[a-z0-9_-]{1,64}")
_FLAGS = os.O_NOFOLLOW | os.O_CLOEXEC


@dataclass(frozen=True, slots=True)
class Rights:
    """Whose a file is, from before it has its name."""

    mode: int = 0o640
    owner: int = -1  # -1: who writes it
    group: int = -1


def save_text(folder: Path, name: str, text: str, history: int, rights: Rights | None = None) -> Path:
    """Make `folder/name.yaml` hold `text`; the earlier one becomes `name.0001.yaml` and up, `history` kept.

    A power cut at any point leaves the old or the new file, and none of the earlier ones less, but for the
    oldest beyond `history` once the new one is safe. `rights` None: mode 0640, less what the umask takes.
    Raises ConfigError (a name that is not 1 to 64 of a-z 0-9 _ -, bytes that read back differently), OSError
    (no folder, disk full, no permission): then the old file stands, whatever is left beside it.
    """
    _require_name(folder, name)
    current, fresh = f"{name}.yaml", f".{name}.yaml.new"
    directory = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        _write(directory, fresh, text.encode(), rights)
        _keep(directory, name, current)
        os.replace(fresh, current, src_dir_fd=directory, dst_dir_fd=directory)
        os.fsync(directory)
        for number in _numbers(directory, name)[:-history]:
            os.unlink(_numbered(name, number), dir_fd=directory)
    finally:
        os.close(directory)
    return folder / current


def draft_of(folder: Path, name: str) -> Path:
    """Where the work in progress on `folder/name.yaml` stands."""
    return folder / f".{name}.draft.yaml"


def save_draft(folder: Path, name: str, text: str) -> Path:
    """Make the draft of `folder/name.yaml` hold `text`: old or new, never mixed, and no history.

    Raises as `save_text`.
    """
    _require_name(folder, name)
    path = draft_of(folder, name)
    fresh = f"{path.name}.new"
    directory = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        _write(directory, fresh, text.encode(), None)
        os.replace(fresh, path.name, src_dir_fd=directory, dst_dir_fd=directory)
        os.fsync(directory)
    finally:
        os.close(directory)
    return path


def _require_name(folder: Path, name: str) -> None:
    if not _NAME.fullmatch(name):
        raise file_error(str(folder), f"{name!r} is no name for a file: use 1 to 64 of a-z, 0-9, _ and -")


def _write(directory: int, name: str, data: bytes, rights: Rights | None) -> None:
    """A file with `data`, on the disk and read back. What a power cut left behind is overwritten."""
    fd = os.open(name, os.O_RDWR | os.O_CREAT | os.O_TRUNC | _FLAGS, 0o640, dir_fd=directory)
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
    finally:
        os.close(fd)


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
    """Of the earlier files, the oldest first."""
    form = re.compile(re.escape(name) + r"\.(\d{4,9})\.yaml")
    return sorted(int(found[1]) for entry in os.listdir(directory) if (found := form.fullmatch(entry)))
