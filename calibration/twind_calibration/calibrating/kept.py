"""A calibration file written anew so that the daemon can still read it: owner, group and mode as they were.

The one place where verbs write it. Old or new, never mixed; the earlier file stays as numbered history.
"""

import os
import stat
from pathlib import Path

from twind.config.calibration_file import Calibration, save_calibration
from twind.config.located import ConfigError
from twind.ctl.verb import Rejected


def save(calibration: Calibration, path: Path) -> None:
    """Make the file at `path` hold it. A first file, written by root, is given to whom its folder belongs.

    Raises Rejected that names the file, why it was not written, and the remedy.
    """
    try:
        if path.suffix != ".yaml":
            raise OSError("its name does not end in .yaml")
        before = _before(path)
        save_calibration(calibration, path.parent, path.stem)
        if before is None:
            folder = path.parent.stat()
            owner, group = folder.st_uid, folder.st_gid
        else:
            path.chmod(stat.S_IMODE(before.st_mode))
            owner, group = before.st_uid, before.st_gid
        if os.geteuid() == 0:  # else the daemon's user could read it no more
            os.chown(path, owner, group)
    except FileNotFoundError:
        raise Rejected(f"{path}: there is no folder {path.parent}: `mkdir -p {path.parent}`") from None
    except PermissionError as error:
        raise Rejected(f"{path} cannot be written: {error.strerror}; try with sudo") from None
    except (OSError, ConfigError) as error:
        raise Rejected(f"{path} cannot be written: {error}") from None


def _before(path: Path) -> os.stat_result | None:
    try:
        return path.stat()
    except FileNotFoundError:
        return None
