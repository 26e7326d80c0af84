"""Trial of a robot's model: MuJoCo compiles it once in a process with bounds of time and memory.

A model that only has elements of `_PLAIN` costs what its text costs, and needs no trial. All others may cost
any memory and time: meshes, pictures, elements that make copies, muscles, cameras; decoders may crash.
"""

import os
import stat
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from twind.bounded_process import ProcessBounds, call_module
from twind.config.model_numbers import RECORDED, ModelElement, require_sane_text
from twind.config.yaml_tree import ConfigError, FilePosition
from twind.exceptions import InvalidInput

BOUNDS = ProcessBounds(seconds=20, memory=3072, output=1)
MAX_FILE = 64 << 20  # bytes of a mesh, height field or picture
MAX_ALL = 256 << 20  # bytes of all of them
MAX_PLAIN = 1000  # elements of a model without a trial; the largest built-in robot has some 200
WORKER = "twind.twin.model_trial_worker"

_PLAIN = frozenset(
    (
        *("mujoco", "include", "compiler", "option", "flag", "default", "visual", "global", "headlight"),
        *("rgba", "quality", "map", "scale", "statistic", "worldbody", "body", "inertial", "joint"),
        *("freejoint", "geom", "site", "light", "contact", "pair", "exclude", "equality", "connect", "weld"),
        *("actuator", "general", "position", "velocity", "motor", "sensor", "accelerometer", "gyro"),
        *("framequat", "framepos", "force", "torque", "jointpos", "jointvel", "touch"),
    )
)
# Attributes of plain elements that reserve memory by a number, or for all elements of a kind.
_RESERVING = frozenset(
    (
        *("user", "dyntype", "actdim", "nsample", "delay", "interval"),
        *("resolution", "dim", "num", "mesh", "hfield"),
    )
)
_MUSCLE = "muscle"  # gaintype of a `general`: its range of length is found by a simulation
_FOLDERS = ("meshdir", "texturedir", "assetdir")


def require_readable_model(path: Path, elements: Sequence[ModelElement]) -> None:
    """Require that the model at `path` can be compiled within `BOUNDS`; `elements`: all that it has.

    Raises ConfigError: it cannot, or it names a file that is none or too large.
    """
    _require_files(elements)
    _try(elements, str(path), {"path": str(path)})


def require_readable_text(mjcf: str, folder: Path) -> bool:
    """Require the same, and sane numbers, of a model that has no file; its meshes are below `folder`.

    Returns whether it was tried without its files, and has to be compiled so: this user may not read one.
    Raises ConfigError.
    """
    elements = require_sane_text(mjcf, folder)
    left_out = not _require_files(elements)
    _try(
        elements,
        str(folder / RECORDED),
        {"mjcf": mjcf, "folder": str(folder), "files_left_out": left_out},
    )
    return left_out


def _try(elements: Sequence[ModelElement], name: str, request: Mapping[str, object]) -> None:
    """Compile a model where it may cost more than its text. Raises ConfigError."""
    if len(elements) <= MAX_PLAIN and all(map(_is_plain, elements)):
        return
    try:
        call_module(WORKER, request, BOUNDS, file=name)
    except InvalidInput as error:
        raise ConfigError(error.where or name, FilePosition(0, 0), "", error.reason) from None


def _is_plain(element: ModelElement) -> bool:
    given = element.attributes
    return element.name in _PLAIN and _RESERVING.isdisjoint(given) and _MUSCLE not in given.values()


def _require_files(elements: Sequence[ModelElement]) -> bool:
    """Check the files that elements name; return whether this user may read all. Raises ConfigError."""
    folders = {
        value
        for each in elements
        if each.name == "compiler"
        for key, value in each.attributes.items()
        if key in _FOLDERS
    }
    sizes: dict[str, int] = {}
    readable = True
    for element in elements:
        for name in _names(element):
            places = tuple(_places(element, name, folders))
            readable &= any(os.access(path, os.R_OK) for path in places)
            for path in places:
                sizes[os.path.realpath(path)] = _size(element, path)
                if sum(sizes.values()) > MAX_ALL:
                    raise element.refused(
                        f"the files of the model are larger than {MAX_ALL >> 20} MiB: decimate them"
                    )
    return readable


def _names(element: ModelElement) -> Iterator[str]:
    """Yield the file names in an element; included files are checked already."""
    if element.name not in ("include", "model"):
        yield from (value for key, value in element.attributes.items() if key.startswith("file") and value)


def _places(element: ModelElement, name: str, folders: set[str]) -> Iterator[Path]:
    """Yield where MuJoCo may find a file, as far as there is one."""
    for home in {element.home, element.file.parent}:
        for folder in {"", *folders}:
            for each in {name, os.path.basename(name)}:  # `strippath`
                path = home / folder / each
                if os.path.exists(path):
                    yield path


def _size(element: ModelElement, path: Path) -> int:
    found = os.stat(path)
    if not stat.S_ISREG(found.st_mode):
        raise element.refused(f"{path} is no file: name a regular one")
    if found.st_size > MAX_FILE:
        raise element.refused(f"{path} is larger than {MAX_FILE >> 20} MiB: decimate it")
    return found.st_size
