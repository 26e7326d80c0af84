"""A calibration file written anew so that the daemon can still read it: owner, group and mode as they were.

The one place where verbs write it. Old or new, never mixed; the earlier file stays as numbered history.
"""

import contextlib
import os
import stat
from collections.abc import Iterator
from pathlib import Path

from twind.command_line.verb import Rejected
from twind.config import atomic_save
from twind.config.atomic_save import FileOwnership, LockedFolder
from twind.config.calibration_file import HISTORY, Calibration, dump_calibration
from twind.config.yaml_tree import ConfigError
from twind.new_file import unwritten


@contextlib.contextmanager
def lock_folder(path: Path) -> Iterator[LockedFolder]:
    """Lock the folder of the file at `path`: its contents stay as they are until the end of the block.

    Ask no question in the block: other programs wait. Raises Rejected: no folder, or another program has it.
    """
    with contextlib.ExitStack() as stack:
        with refusing(path):
            folder = stack.enter_context(atomic_save.lock_folder(path.parent))
        yield folder


def save(calibration: Calibration, path: Path, held: LockedFolder | None = None) -> None:
    """Save a calibration at `path`. A new file that root writes gets the owner of its folder.

    `held`: its folder, if already locked. Raises Rejected that names the
    file, why it was not written, and the remedy.
    """
    with contextlib.nullcontext(held) if held is not None else lock_folder(path) as folder, refusing(path):
        if path.suffix != ".yaml":
            raise OSError("its name does not end in .yaml")
        folder.save_text(path.stem, dump_calibration(calibration), HISTORY, rights(path))


@contextlib.contextmanager
def refusing(path: Path) -> Iterator[None]:
    """Convert errors of a write to `path` into Rejected with the remedy."""
    try:
        yield
    except FileNotFoundError:
        raise Rejected(f"{path}: there is no folder {path.parent}: `mkdir -p {path.parent}`") from None
    except OSError as error:
        raise Rejected(f"{path} cannot be written: {unwritten(error)}") from None
    except ConfigError as error:
        raise Rejected(f"{path} cannot be written: {error}") from None


def rights(path: Path) -> FileOwnership | None:
    """Return the ownership to keep, so that the daemon's user can still read the file.

    Only root sets owner and group.
    """
    try:
        before: os.stat_result | None = path.stat()
    except FileNotFoundError:
        before = None
    whose = before or path.parent.stat()
    owner, group = (whose.st_uid, whose.st_gid) if os.geteuid() == 0 else (-1, -1)
    if before is None:
        return FileOwnership(owner=owner, group=group) if os.geteuid() == 0 else None
    return FileOwnership(stat.S_IMODE(before.st_mode), owner, group)
