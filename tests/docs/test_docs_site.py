"""The site of `make docs`: every page has its place, and a dead link fails the build."""

import os
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.support.doc_pages_text import PAGES, ROOT, name

SITE = (ROOT / "mkdocs.yml").read_text()
NAVIGATION = re.findall(r": ((?:[\w-]+/)*[\w-]+\.md)$", SITE.partition("\nnav:\n")[2], re.MULTILINE)
without_mkdocs = pytest.mark.skipif(not find_spec("mkdocs"), reason="the extra `docs` is not installed")


def build(sources: Path, site: Path) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(site)]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    return subprocess.run(command, cwd=sources, env=environment, capture_output=True, text=True)


def test_the_navigation_has_no_page_twice_and_none_that_does_not_exist() -> None:
    assert len(NAVIGATION) == len(set(NAVIGATION)) > 15
    assert not [page for page in NAVIGATION if not (ROOT / page).is_file()]


def test_the_readme_links_to_every_page_of_the_navigation_but_those_that_are_not_installed() -> None:
    readme = (ROOT / "README.md").read_text()
    apart = {"README.md", "drivers/README.md", "docs/virtual-can.md"}  # the last: linked by docs/virtual.md
    assert not [page for page in NAVIGATION if page not in apart and f"]({page})" not in readme]


@without_mkdocs
def test_the_site_has_every_page_and_loads_nothing_from_another_host(tmp_path: Path) -> None:
    built = build(ROOT, tmp_path)
    assert built.returncode == 0, built.stderr
    for page in PAGES:
        path = name(page).replace("README.md", "index.md").replace(".md", ".html")
        assert (tmp_path / path).is_file(), path
    loaded = re.compile(r"<(?:script|img|iframe)[^>]+src=\"https?:|<link[^>]+stylesheet[^>]+href=\"https?:")
    assert not [each for each in tmp_path.rglob("*.html") if loaded.search(each.read_text())]
    assert (tmp_path / "search" / "search_index.json").stat().st_size > 100_000


@without_mkdocs
@pytest.mark.parametrize("link", ["docs/none.md", "docs/tutorial.md#nowhere"])
def test_a_dead_link_fails_the_site_build(link: str, tmp_path: Path) -> None:
    sources = tmp_path / "sources"
    sources.mkdir()
    for each in ("README.md", "CHANGELOG.md", "mkdocs.yml"):
        shutil.copy(ROOT / each, sources)
    for each in ("docs", "calibration", "drivers", "systemd", "packaging", "twind/robots", "twind/protocol"):
        shutil.copytree(ROOT / each, sources / each, ignore=shutil.ignore_patterns("__pycache__"))
    with (sources / "README.md").open("a") as readme:
        readme.write(f"\n[dead]({link})\n")
    built = build(sources, tmp_path / "site")
    assert built.returncode != 0
    assert link in built.stderr
