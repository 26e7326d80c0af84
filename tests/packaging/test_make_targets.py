"""`make` without a target installs and ends; `make help` lists targets that exist."""

import os
import re
import shutil
import subprocess
from pathlib import Path

from tests.support.doc_pages_text import ROOT


def make(folder: Path, *words: str, **variables: str) -> str:
    """Output of `make` with these variables in its environment, in a folder that has the Makefile alone."""
    shutil.copy(ROOT / "Makefile", folder)
    (folder / "pyproject.toml").touch()
    # Below another make, as in `make test`, it would name the folders that it enters.
    own = {key: value for key, value in os.environ.items() if key not in ("MAKEFLAGS", "MAKELEVEL", "MFLAGS")}
    done = subprocess.run(
        ["make", *words], cwd=folder, env=own | variables, capture_output=True, text=True, check=True
    )
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


def test_what_the_scripts_take_from_the_environment_reaches_them_through_make(tmp_path: Path) -> None:
    """A variable of the Makefile by the same name would be handed on in its place."""
    given = {
        "PYTHONS": "3.12 3.13",
        "EXTRAS": "ros",
        "WHEELS": "wheels",
        "ARCHITECTURE": "arm64",
        "PURGE": "1",
    }
    script = tmp_path / "packaging/deb.sh"
    script.parent.mkdir()
    script.write_text("#!/bin/sh\n" + "".join(f'echo "{name}=${name}"\n' for name in given))
    script.chmod(0o755)
    said = make(tmp_path, "deb", **given)
    assert {f"{name}={value}" for name, value in given.items()} <= set(said.splitlines())
