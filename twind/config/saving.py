"""Files that must be old or new, never mixed: written beside, synced, read back, renamed, folder synced."""

import os
import re
from pathlib import Path

from twind.config.section import file_error

_NAME = re.compile(r"[a-z0-9_-]{1,64}")
_FLAGS = os.O_NOFOLLOW | os.O_CLOEXEC


def save_text(folder: Path, name: str, text: str, history: int) -> Path:
    """Make `folder/name.yaml` hold `text`; the earlier one becomes `name.0001.yaml` and up, `history` kept.

    Mode 0640. A power cut at any point leaves the old or the new file. Raises ConfigError (a name that is not
    1 to 64 of a-z 0-9 _ -, bytes that read back differently), OSError (no folder, disk full, no permission).
    """
    _require_name(folder, name)
    current, fresh = f"{name}.yaml", f".{name}.yaml.new"
    directory = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        _write(directory, fresh, text.encode())
        _keep(directory, name, current, history)
        os.replace(fresh, current, src_dir_fd=directory, dst_dir_fd=directory)
        os.fsync(directory)
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
        _write(directory, fresh, text.encode())
        os.replace(fresh, path.name, src_dir_fd=directory, dst_dir_fd=directory)
        os.fsync(directory)
    finally:
        os.close(directory)
    return path


def _require_name(folder: Path, name: str) -> None:
    if not _NAME.fullmatch(name):
        raise file_error(str(folder), f"{name!r} is no name for a file: use 1 to 64 of a-z, 0-9, _ and -")


def _write(directory: int, name: str, data: bytes) -> None:
    """A file with `data`, on the disk and read back. What a power cut left behind is overwritten."""
    fd = os.open(name, os.O_RDWR | os.O_CREAT | os.O_TRUNC | _FLAGS, 0o640, dir_fd=directory)
    try:
        view = memoryview(data)
        while view:
            view = view[os.write(fd, view) :]
        os.fsync(fd)
        if os.pread(fd, len(data) + 1, 0) != data:
            raise file_error(name, "reads back other than it was written: check the disk")
    finally:
        os.close(fd)


def _keep(directory: int, name: str, current: str, history: int) -> None:
    """A second name for the current file, numbered; the oldest beyond `history` go."""
    numbered = re.compile(re.escape(name) + r"\.(\d{4,9})\.yaml")
    numbers = sorted(int(match[1]) for entry in os.listdir(directory) if (match := numbered.fullmatch(entry)))
    try:
        target = f"{name}.{(numbers[-1] if numbers else 0) + 1:04d}.yaml"
        os.link(current, target, src_dir_fd=directory, dst_dir_fd=directory, follow_symlinks=False)
    except FileNotFoundError:
        return  # the first one ever
    for number in numbers[: max(0, len(numbers) + 1 - history)]:
        os.unlink(f"{name}.{number:04d}.yaml", dir_fd=directory)
