"""Paths of meshes and packages: `package://`, `model://`, `file://` and relative ones.

A package is found in the packages that the caller names, on the ROS paths of the environment, then in the
folders above the file: a folder with `package.xml`, and its neighbours.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote

from twind_calibration.model_import.imported_model import import_refused

# Environment variable: folder below each entry that holds packages.
SEARCH_PATHS = {"ROS_PACKAGE_PATH": "", "AMENT_PREFIX_PATH": "share", "GAZEBO_MODEL_PATH": ""}
MAX_MANIFEST = 64 * 1024
_PACKAGE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")
_MANIFEST_NAME = re.compile(r"<name>\s*([^<\s]+)\s*</name>")


@dataclass(frozen=True, slots=True)
class PackagePaths:
    """Places where packages are searched."""

    start: Path  # folder of the model
    packages: Mapping[str, Path]
    environment: Mapping[str, str]

    def find(self, package: str, where: str) -> Path:
        """Folder of a package. Raises InvalidInput at the place `where`."""
        if _PACKAGE_NAME.fullmatch(package):
            for folder in self._candidates(package):
                if folder.is_dir():
                    return folder.resolve()
        variables = ", ".join(SEARCH_PATHS)
        reason = f"package {package[:80]!r} is in no folder above the file and not in {variables}"
        raise import_refused(f"{reason}; name its folder: {package[:80]}=FOLDER", where=where)

    def resolve(self, reference: str, where: str) -> Path:
        """Path of a file that a model refers to; it need not exist."""
        scheme, separator, rest = reference.partition("://")
        if not separator:
            return (self.start / reference.removeprefix("file:")).absolute()
        if scheme == "file":
            return Path(unquote(rest.removeprefix("localhost")))
        if scheme not in ("package", "model"):
            schemes = "package://, model://, file://"
            raise import_refused(
                f"{reference[:80]!r}: unknown scheme; write {schemes} or a path", where=where
            )
        package, _, path = rest.partition("/")
        folder = self.find(package, where)
        found = (folder / path).resolve()
        if not found.is_relative_to(folder):
            raise import_refused(f"{reference[:80]!r} leads out of its package; write another", where=where)
        return found

    def own_folder(self) -> Path:
        """Folder of the package of the model; the folder of the model where there is none."""
        for folder in self._above():
            if (folder / "package.xml").is_file():
                return folder
        return self.start.resolve()

    def roots(self) -> list[Path]:
        """All folders whose files a model may name."""
        roots = [self.own_folder(), *(path.resolve() for path in self.packages.values())]
        return roots + [entry / below for entry, below in self._entries()]

    def _candidates(self, package: str) -> Iterator[Path]:
        if package in self.packages:
            yield self.packages[package]
        for entry, below in self._entries():
            yield entry / below / package
            if _manifest_name(entry) == package:
                yield entry
        for folder in self._above():
            if _manifest_name(folder) == package or folder.name == package:
                yield folder
            if (folder / package / "package.xml").is_file():
                yield folder / package

    def _entries(self) -> Iterator[tuple[Path, str]]:
        for variable, below in SEARCH_PATHS.items():
            for entry in self.environment.get(variable, "").split(":"):
                if entry:
                    yield Path(entry), below

    def _above(self) -> Iterator[Path]:
        start = self.start.resolve()
        yield start
        yield from start.parents


def _manifest_name(folder: Path) -> str:
    """Name in the manifest of a folder; empty where it has none."""
    try:
        with (folder / "package.xml").open(encoding="utf-8", errors="replace") as file:
            found = _MANIFEST_NAME.search(file.read(MAX_MANIFEST))
    except OSError:
        return ""
    return found[1] if found else ""
