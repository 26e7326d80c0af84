"""One version for all that is released together, and the changelog names it."""

import re
import tomllib
from collections.abc import Iterator
from importlib.metadata import distribution, version

import pytest
from packaging.requirements import Requirement

from tests.support.doc_pages_text import PAGES, ROOT, name
from twind.version import DISTRIBUTION, __version__

PROJECTS = ("pyproject.toml", "integrations/lerobot/pyproject.toml")


@pytest.mark.parametrize("project", PROJECTS)
def test_a_distribution_has_the_version_of_the_program(project: str) -> None:
    read = tomllib.loads((ROOT / project).read_text())
    assert "version" not in read["project"] and read["project"]["dynamic"] == ["version"]
    place = (ROOT / project).parent / read["tool"]["hatch"]["version"]["path"]
    assert place.resolve() == ROOT / "twind/version.py"


def test_the_newest_version_of_the_changelog_is_this_one_and_has_a_date() -> None:
    headings = re.findall(r"^## (.*)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    released = [heading for heading in headings if heading != "Unreleased"]
    assert headings[-len(released) :] == released, "unreleased changes stand above all versions"
    assert re.fullmatch(rf"{re.escape(__version__)} - \d{{4}}-\d\d-\d\d", released[0])


def test_no_page_names_a_file_by_its_version() -> None:
    named = re.compile(r"twind(?:_robot)?[-_]\d+\.\d+\.\d+")
    assert [name(page) for page in PAGES if named.search(page.read_text())] == []


def _needed(name: str) -> Iterator[str]:
    """A distribution of this environment and all that it needs, extras aside."""
    yield name
    for each in map(Requirement, distribution(name).requires or []):
        if each.marker is None or each.marker.evaluate({"extra": ""}):
            yield from _needed(each.name)


def test_a_release_brings_the_versions_that_these_tests_run_with() -> None:
    """constraints.txt names each distribution that twind needs, in the version of this environment."""
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pinned = {line for line in lines if line and not line.startswith("#")}
    needed = {name.lower().replace("_", "-") for name in _needed(DISTRIBUTION)} - {DISTRIBUTION}
    assert {f"{name}=={version(name)}" for name in needed} <= pinned
