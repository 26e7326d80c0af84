"""Pages of the documentation: their paths on this machine, and tables in them that the code makes."""

from collections.abc import Callable, Mapping, Sequence
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


def renew_tables(page: str, tables: Mapping[str, str]) -> str:
    """The page with each table between its lines `<!-- begin NAME -->` and `<!-- end NAME -->`.

    Raises ValueError without these lines.
    """
    for name, table in tables.items():
        begin = f"<!-- begin {name} -->"
        end = f"<!-- end {name} -->"
        before, found, rest = page.partition(begin)
        _, closed, after = rest.partition(end)
        if not found or not closed:
            raise ValueError(f"the page has no {begin} … {end}: add both lines")
        page = f"{before}{begin}\n\n{table}\n\n{end}{after}"
    return page


def rewrite_page(path: Path, renew: Callable[[str], str]) -> None:
    """Replace the text of the page by what `renew` makes of it; its error leaves the file as it is."""
    path.write_text(renew(path.read_text(encoding="utf-8")), encoding="utf-8")
