"""A calibration file written anew so that the daemon can still read it: owner, group and mode as they were.

The one place where verbs write it. Old or new, never mixed; the earlier file stays as numbered history.
"""

import os
import stat
from pathlib import Path

from twind.config.calibration_file import Calibration, save_calibration
from twind.config.located import ConfigError
from twind.config.saving import Rights
from twind.ctl.verb import Rejected


def save(calibration: Calibration, path: Path) -> None:
    """Make the file at `path` hold it. A first file, written by root, is given to whom its folder belongs.

    Raises Rejected that names the file, why it was not written, and the remedy.
    """
    try:
        if path.suffix != ".yaml":
            raise OSError("its name does not end in .yaml")
        save_calibration(calibration, path.parent, path.stem, _rights(path))
    except FileNotFoundError:
        raise Rejected(f"{path}: there is no folder {path.parent}: `mkdir -p {path.parent}`") from None
    except PermissionError as error:
        raise Rejected(f"{path} cannot be written: {error.strerror}; try with sudo") from None
    except (OSError, ConfigError) as error:
        raise Rejected(f"{path} cannot be written: {error}") from None


def _rights(path: Path) -> Rights | None:
    """As they were; only root gives a file away, so that the daemon's user can read it still."""
    try:
        before: os.stat_result | None = path.stat()
    except FileNotFoundError:
        before = None
    whose = before or path.parent.stat()
    owner, group = (whose.st_uid, whose.st_gid) if os.geteuid() == 0 else (-1, -1)
    if before is None:
        return Rights(owner=owner, group=group) if os.geteuid() == 0 else None
    return Rights(stat.S_IMODE(before.st_mode), owner, group)
