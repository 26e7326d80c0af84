"""Import of a robot's model: MJCF, URDF or xacro in, an MJCF with its meshes and the facts beside it out.

A file from elsewhere is read in a process of its own, which bounds time and memory. A crash of a library in
a malformed mesh ends that process alone.
"""

from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import msgspec

from twind.bounded_process import ProcessBounds, call_module
from twind.command_line.extras import how_to_add
from twind_calibration.model_import.imported_model import ImportedModel, import_refused

BOUNDS = ProcessBounds(seconds=120, memory=4096, output=64)
WORKER = "twind_calibration.model_import.import_worker"
NEEDED = ("trimesh", "collada", "xacro")
NO_ITEMS: Mapping[str, Any] = {}


def import_model(
    path: Path,
    folder: Path,
    *,
    floating: bool | None = None,
    packages: Mapping[str, Path] = NO_ITEMS,
    arguments: Mapping[str, str] = NO_ITEMS,
) -> ImportedModel:
    """Read a model file and write `folder/<robot name>.xml` and `folder/meshes`.

    `floating`: whether the base has a free joint; None: as in the file, where a URDF has none. `packages`:
    folders of ROS packages by name, searched first. `arguments`: values of `$(arg NAME)` in xacro.
    Raises InvalidInput: the message is one line with file and place.
    """
    missing = [name for name in NEEDED if find_spec(name) is None]
    if missing:
        raise import_refused(
            f"a model import needs {', '.join(missing)}: {how_to_add('model')}", where=str(path)
        )
    request = {
        "path": str(path),
        "folder": str(folder),
        "floating": floating,
        "packages": {name: str(place) for name, place in packages.items()},
        "arguments": dict(arguments),
    }
    answer = call_module(WORKER, request, BOUNDS, file=str(path))
    return msgspec.convert(answer["model"], ImportedModel, dec_hook=_decode)


def _decode(kind: type, value: Any) -> Any:
    return kind(value) if issubclass(kind, Path) else value
