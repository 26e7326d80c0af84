"""Other Pythons: those on the PATH, and those beside our own."""

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
    for each in (shutil.which(f"python{version}"), _beside(version)):
        if each and _output(each, "-c", "import sys; print(sys.version)").startswith(f"{version}."):
            return each  # a shim may be there for versions that are not
    return None


def _beside(version: str) -> str | None:
    """Version managers keep Pythons in folders side by side."""
    kept = sorted(Path(sys.base_prefix).parent.glob(f"*{version}*/bin/python{version}"))
    return str(kept[-1]) if kept else None


def _output(*command: str) -> str:
    return subprocess.run(command, capture_output=True, text=True).stdout


def python(version: str) -> str:
    """The same; skips the test where there is none."""
    path = found(version)
    if path is None:
        pytest.skip(f"no python{version} here")
    return path
