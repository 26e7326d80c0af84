"""The Debian package and the wheels in it, built once for all tests that install them."""

import os
import shutil
import subprocess
from functools import cache
from pathlib import Path

import pytest

PACKAGING = Path(__file__).parents[1] / "packaging"
NEEDED = ("python3", "python3-venv", "systemd")  # of what the package depends on: the rest every Debian has


@cache
def wheels(below: Path) -> Path:
    """A folder with all wheels: TWIND_WHEELS, or fetched to one below. Skips where neither is to be had."""
    if "TWIND_WHEELS" in os.environ:
        return Path(os.environ["TWIND_WHEELS"])
    folder = below / "wheels"
    command = [PACKAGING / "install.sh", "wheels", folder]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"no wheels to install from (TWIND_WHEELS names a folder): {done.stderr.strip()[-300:]}")
    return folder


def build(into: Path, of: Path) -> Path:
    """The package of these wheels."""
    environment = os.environ | {"WHEELS": str(of), "SOURCE_DATE_EPOCH": "1790000000"}
    command = [PACKAGING / "deb.sh", into]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return Path(done.stdout.strip())


@cache
def package(below: Path) -> Path:
    """The package, in a folder below that one. Skips where it cannot be built."""
    if shutil.which("dpkg-deb") is None:
        pytest.skip("no dpkg-deb here")
    return build(below / "package", wheels(below))


def require_debian() -> None:
    """Skip on a machine whose package manager would not install it."""
    for name in NEEDED:
        command = ["dpkg-query", "-W", "-f", "${db:Status-Status}", name]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.stdout != "installed":
            pytest.skip(f"the package {name} is not installed here")
