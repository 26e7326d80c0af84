"""`make` without a target installs and ends; `make help` lists targets that exist."""

import os
import re
import shutil
import subprocess
from pathlib import Path

from tests.support.doc_pages_text import ROOT


def make(folder: Path, *words: str) -> str:
    """Output of `make` in a folder that has the Makefile alone."""
    shutil.copy(ROOT / "Makefile", folder)
    (folder / "pyproject.toml").touch()
    # Below another make, as in `make test`, it would name the folders that it enters.
    own = {key: value for key, value in os.environ.items() if key not in ("MAKEFLAGS", "MAKELEVEL", "MFLAGS")}
    done = subprocess.run(["make", *words], cwd=folder, env=own, capture_output=True, text=True, check=True)
    return done.stdout


def test_make_without_a_target_installs_and_names_the_next_step(tmp_path: Path) -> None:
    plan = make(tmp_path, "--dry-run")
    assert "--editable '.[dev]'" in plan
    assert "twindctl" not in plan and "pytest" not in plan
    assert "Next: . .venv/bin/activate" in plan.splitlines()[-1]


def test_make_help_lists_targets_that_exist_and_installs_nothing(tmp_path: Path) -> None:
    lines = make(tmp_path, "help").splitlines()
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    listed = {word for line in lines for word in re.findall(r"\bmake ([a-z-]+)", line)}
    assert {"demo", "test", "check", "install"} <= listed <= targets
    assert not (tmp_path / ".venv").exists()
