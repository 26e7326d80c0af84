"""Other Pythons: those on the PATH, or that a version manager there tells of."""

import shutil
import subprocess
import sys
from functools import cache

import pytest


@cache
def found(version: str) -> str | None:
    """The interpreter of `3.10`; None: there is none that runs."""
    if sys.version_info[:2] == tuple(map(int, version.split("."))):
        return sys.executable
    for each in (shutil.which(f"python{version}"), _kept(version)):
        if each and _said(each, "-c", "import sys; print(sys.version)").startswith(f"{version}."):
            return each  # a shim may be there for versions that are not
    return None


def _kept(version: str) -> str | None:
    """Of a version that pyenv has, and does not put on the PATH."""
    if shutil.which("pyenv") is None:
        return None
    prefix = _said("pyenv", "prefix", version).strip()
    return f"{prefix}/bin/python{version}" if prefix else None


def _said(*command: str) -> str:
    return subprocess.run(command, capture_output=True, text=True).stdout


def python(version: str) -> str:
    """The same; skips the test where there is none."""
    path = found(version)
    if path is None:
        pytest.skip(f"no python{version} here")
    return path
