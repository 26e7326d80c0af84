"""Where a page of the documentation lies on this machine, for messages that send there."""

from collections.abc import Sequence
from pathlib import Path

SOURCES = Path(__file__).parent.parent.parent
CALIBRATION = "calibration/README.md"


def page(
    name: str,
    folders: Sequence[Path] = (SOURCES, Path("/usr/local/share/doc/twind"), Path("/usr/share/doc/twind")),
) -> str:
    """The path of a page as the sources name it; "NAME of twind's sources" where this machine has none.

    `folders` are looked through in order: the sources that this runs from, then what `make install` and what
    the Debian package put there (packaging/install.sh).
    """
    for folder in folders:
        if (folder / name).is_file():
            return str(folder / name)
    return f"{name} of twind's sources"
