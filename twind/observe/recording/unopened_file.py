"""Error of a recording that cannot be opened, with the folder of flight files. Standard library only."""

import os
from pathlib import Path

from twind.command_line.verb import Rejected


def unopened(path: Path, error: OSError) -> Rejected:
    """Return the error; for a missing flight file with the folders where dumps are."""
    if not isinstance(error, FileNotFoundError) or path.suffix == ".mcap":
        return Rejected(f"{path}: {error.strerror or error}")
    from twind.config.daemon_settings import places  # only a missing file pays for it

    folder = places(os.environ, os.geteuid()).state / "flight"
    return Rejected(
        f"{path}: {error.strerror}; `twindctl dump` prints the path of its file, usually in {folder}, "
        "of virtual servos in its folder virtual"
    )
