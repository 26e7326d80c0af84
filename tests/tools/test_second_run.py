"""The second run of end-to-end tests, with a real pytest on small files."""

from pathlib import Path

import pytest

from tools import second_run

FAILS_ONCE = """
from pathlib import Path
def test_fails_in_its_first_run():
    mark = Path(__file__).with_suffix(".ran")
    ran = mark.exists()
    mark.touch()
    assert ran
"""
FAILS = "def test_fails_always(): assert False\n"
COUNTS = """
from pathlib import Path
def test_counts():
    with Path(__file__).with_suffix(".count").open("a") as file:
        file.write("x")
"""
PASSES = "def test_passes(): pass\n"


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run in a folder of its own, without the plugins that such files do not need."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")


def run(folder: Path, *texts: str) -> tuple[int, int]:
    """Write test files and run both commands; return their exit codes."""
    tests = folder / "group"
    tests.mkdir()
    (folder / "pytest.ini").write_text("[pytest]\n")
    for number, text in enumerate(texts):
        (tests / f"test_{number}.py").write_text(text)
    first = second_run.run_first(str(tests), ["-q"], folder / "cache")
    return first, second_run.run_again([str(tests)], folder / "cache")


@pytest.mark.parametrize(
    ("texts", "codes"),
    [
        ([PASSES], (0, 0)),
        ([PASSES, FAILS_ONCE, FAILS], (0, 1)),
        ([FAILS] * (second_run.MOST + 1), (1, 1)),
        (["import nothing_of_that_name\n"], (2, 2)),
    ],
    ids=["all pass", "one fails twice", "too many fail", "a file cannot be read"],
)
def test_a_failure_counts_where_the_test_fails_alone_too(
    tmp_path: Path, texts: list[str], codes: tuple[int, int]
) -> None:
    assert run(tmp_path, *texts) == codes


def test_only_the_tests_that_failed_run_again(tmp_path: Path) -> None:
    assert run(tmp_path, COUNTS, FAILS_ONCE) == (0, 0)
    assert (tmp_path / "group/test_0.count").read_text() == "x"
