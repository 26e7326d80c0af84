"""The Debian package and the wheels in it, built once for all tests that install them."""

import fcntl
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import pytest

PACKAGING = Path(__file__).parents[2] / "packaging"
NEEDED = ("python3", "python3-venv", "systemd")  # of what the package depends on: the rest every Debian has


def shared(factory: pytest.TempPathFactory) -> Path:
    """A folder of this run of the tests, the same for all its workers."""
    own = factory.getbasetemp()
    return own.parent if "PYTEST_XDIST_WORKER" in os.environ else own


@contextmanager
def _first(made: Path) -> Iterator[bool]:
    """True for the one process that makes it here; others wait until it is made."""
    with made.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        whole = made.with_suffix(".whole")
        yield not whole.exists()
        whole.touch()


@cache
def wheels(below: Path) -> Path:
    """A folder with all wheels: TWIND_WHEELS, or fetched to one below. Skips where neither is to be had."""
    if "TWIND_WHEELS" in os.environ:
        return Path(os.environ["TWIND_WHEELS"])
    folder = below / "wheels"
    with _first(folder) as mine:
        command = [PACKAGING / "install.sh", "wheels", folder] if mine else ["true"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            said = done.stderr.strip()[-300:]
            pytest.skip(f"no wheels to install from (TWIND_WHEELS names a folder): {said}")
    return folder


def build(into: Path, of: Path, packaging: Path = PACKAGING) -> Path:
    """The package of these wheels, by these scripts."""
    environment = os.environ | {"WHEELS": str(of), "SOURCE_DATE_EPOCH": "1790000000"}
    command = [packaging / "deb.sh", into]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return Path(done.stdout.strip())


@cache
def package(below: Path) -> Path:
    """The package, in a folder below that one. Skips where it cannot be built."""
    require_dpkg_deb()
    of = wheels(below)
    folder = below / "package"
    with _first(folder) as mine:
        if mine:
            build(folder, of)
    (found,) = folder.glob("*.deb")
    return found


def require_dpkg_deb() -> None:
    """Skip on a machine that cannot build packages."""
    if shutil.which("dpkg-deb") is None:
        pytest.skip("no dpkg-deb here")


def former(below: Path, commit: str, more: Sequence[str]) -> Path:
    """The package of an earlier commit, of today's wheels and `more`. Skips where it cannot be built."""
    of = wheels(below)
    sources = below / "former"
    sources.mkdir()
    taken = subprocess.run(
        ["git", "-C", PACKAGING.parent, "archive", commit], capture_output=True, check=False
    )
    if taken.returncode:
        pytest.skip(f"no history with {commit}: {taken.stderr.decode().strip()}")
    subprocess.run(["tar", "x", "-C", sources], input=taken.stdout, check=True)
    folder = below / "former-wheels"
    shutil.copytree(of, folder, ignore=shutil.ignore_patterns("twind_robot-*"))
    subprocess.run([PACKAGING / "install.sh", "own", folder, sources], check=True)
    fetch = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--dest", str(folder), *more]
    if subprocess.run(fetch, check=False).returncode:
        pytest.skip(f"no wheels of {', '.join(more)}")
    return build(below / "former-package", folder, sources / "packaging")


def require_debian() -> None:
    """Skip on a machine whose package manager would not install it."""
    for name in NEEDED:
        command = ["dpkg-query", "-W", "-f", "${db:Status-Status}", name]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.stdout != "installed":
            pytest.skip(f"the package {name} is not installed here")
