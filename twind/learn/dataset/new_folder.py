"""A new folder that appears whole or not at all."""

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from twind.command_line.verb import Rejected


def require_absent(out: Path) -> None:
    """Raises Rejected where something is at `out`; an empty folder is nothing."""
    if out.is_symlink() or (out.exists() and not (out.is_dir() and not any(out.iterdir()))):
        raise Rejected(
            f"{out}: is there already, and nothing is added to it; name all recordings in one call and "
            "another folder, or merge two data sets with LeRobot's own tools"
        )


@contextlib.contextmanager
def whole_folder(out: Path) -> Iterator[Path]:
    """Yield a path beside `out` for a folder that becomes `out` at the end; after an error it is deleted.

    Raises Rejected where something is at `out`, OSError.
    """
    require_absent(out)
    out.parent.mkdir(parents=True, exist_ok=True)
    folder = out.parent / f".{out.name}.{os.getpid()}.half"
    try:
        yield folder
        try:
            os.rename(folder, out)
        except OSError:
            require_absent(out)  # another process was first
            raise
    finally:
        with contextlib.suppress(FileNotFoundError):
            shutil.rmtree(folder)
