"""An earlier commit is run from its own folder, whatever the working folder holds."""

import subprocess
import sys
from pathlib import Path

import pytest

from bench.base_commit import BASE, OWN, SourceTree, base_tree, install_missing
from bench.harness import MeasurementUnavailable


def test_a_tree_is_imported_from_its_own_folder(tmp_path: Path) -> None:
    package = tmp_path / "tree" / "twind"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("PLACE = 'the tree'")
    tree = SourceTree("abc", tmp_path / "tree")
    command = [sys.executable, "-c", "import twind; print(twind.PLACE)"]
    ran = subprocess.run(command, env=tree.environment(), cwd=OWN, capture_output=True, text=True, check=True)
    assert ran.stdout == "the tree\n"


@pytest.mark.skipif(not (OWN / ".git").exists(), reason="no clone: there are no earlier commits")
def test_the_base_commit_is_unpacked_without_a_change_to_this_tree(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(BASE, "HEAD")
    with base_tree(tmp_path) as base:
        assert base.built_in_robot("h24").is_file()
        assert base.folder.is_relative_to(tmp_path)


def test_an_unknown_commit_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(BASE, "no-such-commit")
    with pytest.raises(MeasurementUnavailable, match="no base commit"), base_tree(tmp_path):
        pass


def test_a_library_that_cannot_be_had_is_named(tmp_path: Path) -> None:
    required = tmp_path / "no-such-library"
    (tmp_path / "pyproject.toml").write_text(
        f'[project]\ndependencies = ["numpy>=2.1", "no-such-library @ {required.as_uri()}"]\n'
    )
    with pytest.raises(MeasurementUnavailable, match=r"needs no-such-library @ .*: ERROR"):
        install_missing(tmp_path)
    assert not (tmp_path / "dependencies").exists()
