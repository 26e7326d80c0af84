"""Expansion of xacro files, in a process of its own (`xacro_child.py`) that carries out nothing else."""

from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path

from twind.bounded_process import ProcessBounds, call_module
from twind.command_line.extras import how_to_add
from twind_calibration.model_import.imported_model import import_refused
from twind_calibration.model_import.package_paths import SEARCH_PATHS, PackagePaths
from twind_calibration.model_import.xml_tree import XmlElement, parse_xml

BOUNDS = ProcessBounds(seconds=15, memory=512, output=8)
CHILD = "twind_calibration.model_import.xacro_child"


def is_xacro(root: XmlElement, path: Path) -> bool:
    """Check whether a file has to be expanded."""
    return path.suffix == ".xacro" or any(element.tag.startswith("xacro:") for element in root.walk())


def expand_xacro(path: Path, paths: PackagePaths, arguments: Mapping[str, str]) -> XmlElement:
    """Tree of the expanded file; places are those of the sources. Raises InvalidInput."""
    if find_spec("xacro") is None:
        raise import_refused(f"a xacro file needs the package xacro: {how_to_add('model')}", where=str(path))
    request = {
        "file": str(path),
        "arguments": dict(arguments),
        "packages": {name: str(folder.absolute()) for name, folder in paths.packages.items()},
        "environment": {name: paths.environment[name] for name in SEARCH_PATHS if name in paths.environment},
    }
    answer = call_module(CHILD, request, BOUNDS, file=str(path), environment={"PYTHONUTF8": "1"})
    return parse_xml(answer["xml"].encode(), str(path), answer["sources"])
