"""Source trees that are compared in one run: this one and an earlier commit of it.

A tree is used through its programs and files only: modules of the earlier commit may have other names.
"""

import os
import re
import subprocess
import sys
import tarfile
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from bench.harness import MeasurementUnavailable

OWN = Path(__file__).parents[1]
BASE = "BASE"  # environment variable: the commit to compare with
LANDED = ("origin/main", "main")  # branches whose last commit has landed
DEPENDENCIES = "dependencies"  # folder of a tree: libraries that it needs and this interpreter lacks
PACKAGES = (".", "drivers", "calibration", DEPENDENCIES)


@dataclass(frozen=True, slots=True)
class SourceTree:
    """A folder with the sources of `twind`, run by this interpreter."""

    name: str  # `this tree`, or the short commit
    folder: Path

    def environment(self) -> dict[str, str]:
        """Environment in which Python imports `twind` from this tree, never from the working folder."""
        packages = os.pathsep.join(str(self.folder / each) for each in PACKAGES)
        return os.environ | {"PYTHONPATH": packages, "PYTHONSAFEPATH": "1"}

    def built_in_robot(self, name: str) -> Path:
        """Robot file that this tree brings."""
        return self.folder / "twind" / "robots" / f"{name}.yaml"


def own_tree() -> SourceTree:
    """Tree that this program belongs to, with its uncommitted changes."""
    return SourceTree("this tree", OWN)


@contextmanager
def base_tree(folder: Path) -> Iterator[SourceTree]:
    """Yield the base commit, unpacked below `folder`. Raises MeasurementUnavailable."""
    commit = _git("rev-parse", "--short", os.environ.get(BASE) or _last_landed())
    place = folder / f"base-{commit}"
    packed = folder / f"{commit}.tar"
    _git("archive", "--output", str(packed), commit)
    with tarfile.open(packed) as archive:
        archive.extractall(place, filter="data")
    packed.unlink()
    compile_all = [
        sys.executable,
        "-m",
        "compileall",
        "-q",
        *(str(place / each) for each in ("twind", "drivers")),
    ]
    subprocess.run(compile_all, check=False, stdout=subprocess.DEVNULL)
    install_missing(place)
    yield SourceTree(commit, place)


def install_missing(place: Path) -> None:
    """Install what the tree at `place` requires and this interpreter lacks, into the tree.

    A library that twind has used until then is installed no longer. Raises MeasurementUnavailable.
    """
    project = tomllib.loads((place / "pyproject.toml").read_text())["project"]
    missing = [each for each in project.get("dependencies", ()) if not _installed(each)]
    if not missing:
        return
    pip = (sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target")
    done = subprocess.run([*pip, str(place / DEPENDENCIES), *missing], capture_output=True, text=True)
    if done.returncode != 0:
        last = " ".join(done.stderr.strip().splitlines()[-1:])
        raise MeasurementUnavailable(f"the base commit needs {', '.join(missing)}: {last}")


def _installed(requirement: str) -> bool:
    try:
        version(re.split(r"[^\w.-]", requirement, maxsplit=1)[0])
    except PackageNotFoundError:
        return False
    return True


def _last_landed() -> str:
    """Newest landed commit that is not the measured one. Raises MeasurementUnavailable."""
    changed = bool(_git("status", "--porcelain", "--untracked-files=no"))
    for branch in LANDED:
        try:
            common = _git("merge-base", "HEAD", branch)
        except MeasurementUnavailable:
            continue
        same = common == _git("rev-parse", "HEAD")
        return f"{common}~1" if same and not changed else common
    return "HEAD" if changed else "HEAD~1"


def _git(*arguments: str) -> str:
    try:
        done = subprocess.run(["git", "-C", str(OWN), *arguments], capture_output=True, text=True, check=True)
    except FileNotFoundError:
        raise MeasurementUnavailable("no base commit: git is not installed") from None
    except subprocess.CalledProcessError as error:
        last = error.stderr.strip().splitlines()[-1:]
        raise MeasurementUnavailable(f"no base commit: {' '.join(last)}") from None
    return done.stdout.strip()
