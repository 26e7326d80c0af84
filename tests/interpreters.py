"""Other Pythons of this machine: on the PATH, or where pyenv keeps them."""

import os
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest


@cache
def found(version: str) -> str | None:
    """The interpreter of `3.10`; None: there is none that runs."""
    if sys.version_info[:2] == tuple(map(int, version.split("."))):
        return sys.executable
    root = Path(os.environ.get("PYENV_ROOT") or Path.home() / ".pyenv")
    kept = sorted(root.glob(f"versions/{version}.*/bin/python{version}"))
    on_path = shutil.which(f"python{version}")
    for each in [*([on_path] if on_path else []), *map(str, kept)]:
        said = subprocess.run([each, "-c", "import sys; print(sys.version)"], capture_output=True, text=True)
        if said.stdout.startswith(f"{version}."):  # a shim of pyenv is there for versions that are not
            return each
    return None


def python(version: str) -> str:
    """The same; skips the test where there is none."""
    path = found(version)
    if path is None:
        pytest.skip(f"no python{version} here")
    return path
