"""A hook of MkDocs: the site has the layout of the sources, so that links between pages hold without copies.

Pages are README.md, CHANGELOG.md, docs/ and the README of each folder in `ROOMS`. Any other file that a page
links to is copied into the site as it is.
"""

import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parent.parent
ROOMS = ("calibration", "drivers", "systemd", "packaging/metrics")
LINK = re.compile(r"\]\(([^)#\s]+)")


def pages() -> list[Path]:
    """Markdown files of the site."""
    rooms = [ROOT / room / "README.md" for room in ROOMS]
    return [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md")), *rooms]


def linked(page: Path) -> set[Path]:
    """Files of the sources that a page links to."""
    targets = [link for link in LINK.findall(page.read_text(encoding="utf-8")) if "://" not in link]
    return {target for link in targets if (target := (page.parent / link).resolve()).is_file()}


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """The files of the theme, the pages and what they link to, each at its path in the sources."""
    sources = pages()
    for page in list(sources):
        sources.extend(sorted(linked(page) - set(sources)))
    theme = [each for each in files if each.src_dir != config.docs_dir]
    paths = [path.relative_to(ROOT).as_posix() for path in sources]
    added = [File.generated(config, name, abs_src_path=str(ROOT / name)) for name in paths]
    return Files([*theme, *added])
