"""Reference page of the commands: as generated, complete, short."""

from pathlib import Path

import pytest

from twind.ctl.verb_catalog import verb_names
from twind.manual.write_cli_page import cli_page, main

PAGE = Path(__file__).parents[2] / "docs" / "cli.md"
MOST = 900  # words


@pytest.fixture(scope="module")
def page() -> str:
    return cli_page()


def test_the_committed_page_is_the_generated_one(page: str) -> None:
    assert PAGE.read_text() == page, "python -m twind.manual.write_cli_page docs/cli.md"


def test_the_command_writes_the_page(tmp_path: Path, page: str) -> None:
    assert main([str(tmp_path / "cli.md")]) == 0
    assert (tmp_path / "cli.md").read_text() == page


def test_the_page_has_one_row_for_each_verb_and_program(page: str) -> None:
    rows = [line.split("`")[1] for line in page.splitlines() if line.startswith("| `")]
    assert sorted(rows) == sorted([*verb_names(), "twind", "twind-virtual"])


def test_the_page_leaves_the_common_options_of_a_verb_to_its_help(page: str) -> None:
    options = "which of `--socket`, `-i`, `--remote`, `--json` it takes"
    assert f"The help of a verb lists {options}" in page


def test_the_page_is_short(page: str) -> None:
    words = [word for word in page.split() if any(letter.isalnum() for letter in word)]
    assert len(words) <= MOST
