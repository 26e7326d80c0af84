"""Source trees that are compared in one run: this one and an earlier commit of it.

A tree is used through its programs and files only: modules of the earlier commit may have other names.
"""

import os
import subprocess
import sys
import tarfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from bench.harness import MeasurementUnavailable

OWN = Path(__file__).parents[1]
BASE = "BASE"  # environment variable: the commit to compare with
LANDED = ("origin/main", "main")  # branches whose last commit has landed
PACKAGES = (".", "drivers", "calibration")


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
    yield SourceTree(commit, place)


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
