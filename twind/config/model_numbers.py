"""Bounds of the numbers of a model and of the files that it includes.

All are finite. Those of `<option>`, `<compiler>` and `<size>`, and counts of copies, are within a range.

Pure XML, MJCF or URDF: the compiled model is unknown here. MuJoCo takes a step of `nan`, `1e-300` or `0x10`.
An unknown attribute, a wrong word and a missing file are left to MuJoCo, which reports them by line.
"""

import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.parsers import expat

from twind.config.yaml_tree import ConfigError, FilePosition
from twind.exceptions import InvalidInput
from twind.plain_file import read_plain

MAX_MJCF = 8 * 1024 * 1024  # bytes of one file
SMALLEST_ARENA = 1 << 20  # bytes; with 32 KiB a 24-joint humanoid ends the simulation by a stack overflow
LARGEST_ARENA = 1 << 30  # bytes; MuJoCo gives a 24-joint humanoid 15 MiB

_DECIMAL = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?")
_WHOLE = re.compile(r"[-+]?[0-9]+")
_MEMORY = re.compile(r"([0-9]{1,18})([KMGTPE]?)", re.IGNORECASE)
_ATTRIBUTE = re.compile(rb"([^\s=<>/\"']+)\s*=\s*(\"[^\"]*\"|'[^']*')")


@dataclass(frozen=True, slots=True)
class NumberBound:
    """Numbers of one attribute: the range of each, and how many there are at most."""

    least: float
    most: float
    unit: str = ""
    count: int = 1
    whole: bool = False
    off: float = math.nan  # allowed besides the range: MuJoCo's word for "not given"

    def __str__(self) -> str:
        kind = "whole number" if self.whole else "number"
        many = f"one {kind}" if self.count == 1 else f"at most {self.count} {kind}s"
        off = "" if math.isnan(self.off) else f"{self.off:g}, or "
        return f"{off}{many} from {self.least:.10g} to {self.most:.10g}{self.unit and ' ' + self.unit}"

    def __contains__(self, number: float) -> bool:
        return self.least <= number <= self.most or number == self.off


def _whole(least: int, most: int, count: int = 1) -> NumberBound:
    return NumberBound(least, most, count=count, whole=True)


# A tick lasts 1 ms to 100 ms. A shorter step than 0.1 ms takes more time to compute than it simulates.
_STEP = NumberBound(1e-4, 0.1, "s")
_TOLERANCE = NumberBound(0.0, 1.0)
_ITERATIONS = _whole(1, 10_000)  # 0 would leave limits and contacts without force
_OPTION: Mapping[str, NumberBound] = {
    "timestep": _STEP,
    "impratio": NumberBound(1e-3, 1e6),
    "gravity": NumberBound(-100.0, 100.0, "m/s^2", 3),
    "wind": NumberBound(-100.0, 100.0, "m/s", 3),
    "magnetic": NumberBound(-1e6, 1e6, count=3),  # the unit is the model's own: tesla to nanotesla
    "density": NumberBound(0.0, 25_000.0, "kg/m^3"),  # osmium: 22 590
    "viscosity": NumberBound(0.0, 10_000.0, "Pa s"),  # honey: 10
    "o_margin": NumberBound(0.0, 1.0, "m"),
    "o_solref": NumberBound(-1e6, 1e6, count=2),  # negative: stiffness and damping
    "o_solimp": NumberBound(0.0, 100.0, count=5),
    "o_friction": NumberBound(0.0, 1000.0, count=5),
    "iterations": _ITERATIONS,
    "ls_iterations": _ITERATIONS,
    "noslip_iterations": _whole(0, 10_000),
    "ccd_iterations": _ITERATIONS,
    "sdf_iterations": _whole(0, 10_000),
    "sdf_initpoints": _whole(0, 10_000),
    "tolerance": _TOLERANCE,
    "ls_tolerance": _TOLERANCE,
    "noslip_tolerance": _TOLERANCE,
    "ccd_tolerance": _TOLERANCE,
    "sleep_tolerance": _TOLERANCE,
    "actuatorgroupdisable": _whole(0, 30, 31),
}
_COMPILER: Mapping[str, NumberBound] = {
    "boundmass": NumberBound(0.0, 1000.0, "kg"),
    "boundinertia": NumberBound(0.0, 1000.0, "kg m^2"),
    "settotalmass": NumberBound(0.0, 10_000.0, "kg", off=-1.0),
    "inertiagrouprange": _whole(0, 31, 2),
}
_LENGTHRANGE: Mapping[str, NumberBound] = {
    "accel": NumberBound(0.0, 1e6),
    "maxforce": NumberBound(0.0, 1e9),
    "timeconst": NumberBound(1e-4, 1000.0, "s"),
    "timestep": NumberBound(0.0, 0.1, "s"),  # 0: the model's
    "inttotal": NumberBound(0.0, 1000.0, "s"),
    "interval": NumberBound(0.0, 1000.0, "s"),
    "tolrange": NumberBound(0.0, 1000.0),
}
_USER = ("body", "jnt", "geom", "site", "cam", "tendon", "actuator", "sensor")
_SIZE: Mapping[str, NumberBound] = {
    "memory": NumberBound(SMALLEST_ARENA, LARGEST_ARENA, "bytes (1M to 1G)", whole=True, off=-1.0),
    "nstack": _whole(-1, LARGEST_ARENA // 8),  # of 8 bytes
    "njmax": _whole(-1, 10_000),  # the arena grows with its square: 800 MB
    "nconmax": _whole(-1, 10_000),
    "nuserdata": _whole(0, 1_000_000),
    "nkey": _whole(0, 10_000),
    **{f"nuser_{kind}": _whole(-1, 1000) for kind in _USER},
}
BOUNDS: Mapping[str, Mapping[str, NumberBound]] = {
    "option": _OPTION,
    "compiler": _COMPILER,
    "lengthrange": _LENGTHRANGE,  # stands below `compiler`
    "size": _SIZE,
}
# Counts that multiply what the file says. Their product is left to a trial (`model_trial.py`).
COUNTS: Mapping[str, Mapping[str, NumberBound]] = {
    "hfield": {"nrow": _whole(0, 4096), "ncol": _whole(0, 4096)},
    "texture": {"width": _whole(0, 8192), "height": _whole(0, 49_152)},  # six squares of a cube
    "replicate": {"count": _whole(1, 10_000)},
    "composite": {"count": _whole(0, 1000, 3)},
    "flexcomp": {"count": _whole(0, 1000, 3)},
    "numeric": {"size": _whole(0, 1_000_000)},
}
_ALL = {**BOUNDS, **COUNTS}
MAX_FILES = 100  # of one model
MAX_ELEMENTS = 100_000
MAX_DEPTH = 200
_NO_NUMBER = re.compile(r"[-+]?(nan(\([^\s]*\))?|inf|infinity)", re.IGNORECASE)
_FILES = ("include", "model")  # elements that name a further file of the model
RECORDED = "recorded model"  # in place of the file name of a model that has none


@dataclass(frozen=True, slots=True)
class ModelElement:
    """The start of one XML element: its place, and its attributes with references resolved.

    `home`: the folder of the model that it belongs to.
    """

    file: Path
    home: Path
    name: str
    offset: int  # bytes
    mark: FilePosition
    attributes: Mapping[str, str]

    def refused(self, message: str) -> ConfigError:
        """Error at the place of this element."""
        return ConfigError(str(self.file), self.mark, self.name, message)


def require_sane_numbers(path: Path) -> list[ModelElement]:
    """Check the model at `path`, the files that it includes and the models that it attaches; their elements.

    Raises ConfigError: a number that is not finite or outside its bound, by file, line and column; a file
    that is no XML, too large, or declares entities; too many files or elements.
    """
    found: list[ModelElement] = []
    waiting = [(path, path.parent)]  # a file, and the folder of the model that it belongs to
    checked: set[tuple[str, str]] = set()
    while waiting:
        file, home = waiting.pop()
        key = (os.path.realpath(file), os.path.realpath(home))  # one file has many spellings
        if key in checked:
            continue
        checked.add(key)
        if len(checked) > MAX_FILES:
            raise _file_refused(file, f"the model has more than {MAX_FILES} files: join them")
        text = _text(file)
        elements = _elements(file, home, text, MAX_ELEMENTS - len(found))
        found += elements
        for element in elements:
            _check(text, element)
            other = _named(element)
            if other is not None:
                waiting.append((other, other.parent if element.name == "model" else home))
    return found


def require_sane_text(mjcf: str, folder: Path) -> list[ModelElement]:
    """Check a model that has no file, as recordings hold it: all in one text, meshes below `folder`.

    Returns its elements. Raises ConfigError as `require_sane_numbers`, and for a text that names a file of
    further elements.
    """
    file = folder / RECORDED
    data = mjcf.encode("utf-8", "surrogatepass")
    if len(data) > MAX_MJCF:
        raise _file_refused(file, f"the text of the model is larger than {MAX_MJCF >> 20} MiB: shorten it")
    text = _without_comments(data)
    elements = _elements(file, folder, text, MAX_ELEMENTS)
    for element in elements:
        if element.name in _FILES and "file" in element.attributes:
            raise element.refused("a recorded model has no further files: remove the element")
        _check(text, element)
    return elements


def _file_refused(file: Path, reason: str) -> ConfigError:
    return ConfigError(str(file), FilePosition(0, 0), "", reason)


def _named(element: ModelElement) -> Path | None:
    """The file that an element includes or attaches; None: it names none that exists.

    As MuJoCo looks for it: below the folder of the model, else below the folder of the including file.
    """
    if element.name not in _FILES or "file" not in element.attributes:
        return None
    name = element.attributes["file"]
    places = (element.home / name, element.file.parent / name)
    # os.path.exists, unlike Path.exists, is False for a path that is too long
    return next((path for path in places if os.path.exists(path)), None)


def _text(file: Path) -> bytes:
    """The file's bytes, each comment replaced by spaces. Raises ConfigError."""
    try:
        data = read_plain(file, MAX_MJCF)
    except InvalidInput as error:
        raise _file_refused(file, error.reason) from None
    except OSError as error:
        raise _file_refused(file, f"cannot be read: {error.strerror}") from error
    return _without_comments(data)


def _without_comments(data: bytes) -> bytes:
    """Comments replaced by spaces: MuJoCo's reader allows `--` and any byte inside them, expat does not."""
    parts: list[bytes] = []
    at = 0
    while (begin := data.find(b"<!--", at)) >= 0 and (end := data.find(b"-->", begin + 4)) >= 0:
        parts += (data[at:begin], re.sub(rb"[^\r\n]", b" ", data[begin : end + 3]))
        at = end + 3
    return b"".join((*parts, data[at:]))


def _elements(file: Path, home: Path, text: bytes, most: int) -> list[ModelElement]:
    """All elements of a file, at most `most`.

    Raises ConfigError: no XML, too many or too deep elements, or a declared entity, whose text can grow
    without bound.
    """
    found: list[ModelElement] = []
    depth = 0
    parser = expat.ParserCreate("utf-8")  # MuJoCo ignores the encoding that a file declares

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        mark = FilePosition(parser.CurrentLineNumber, parser.CurrentColumnNumber + 1)
        found.append(ModelElement(file, home, name, parser.CurrentByteIndex, mark, attributes))
        if depth > MAX_DEPTH or len(found) > most:
            bounds = f"{MAX_ELEMENTS} elements, {MAX_DEPTH} levels"
            raise found[-1].refused(f"larger than a robot: at most {bounds}; shorten the model")

    def end(_name: str) -> None:
        nonlocal depth
        depth -= 1

    def entity(name: str, *_rest: object) -> None:
        mark = _mark(text, parser.CurrentByteIndex)
        raise ConfigError(str(file), mark, "", f"entity {name!r} is declared: write its text out")

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.EntityDeclHandler = entity
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        mark = FilePosition(error.lineno, error.offset + 1)
        raise ConfigError(str(file), mark, "", f"not XML: {expat.ErrorString(error.code)}") from None
    return found


def _check(text: bytes, element: ModelElement) -> None:
    """Raises ConfigError for the first number of an element that is not finite or outside its bound."""
    known = _ALL.get(element.name, {})
    for name, value in element.attributes.items():
        bound = known.get(name)
        if bound is not None:
            wrong = _wrong(_in_bytes(value) if name == "memory" else value, bound)
        else:
            wrong = "is no finite number" if _not_finite(value) else ""
        if wrong:
            shown = ascii(value)[1:-1]  # in one line, whatever is in it
            shown = shown if len(shown) <= 40 else shown[:37] + "..."
            remedy = f"write {bound or 'finite numbers'}, or remove the attribute"
            mark = _mark(text, _offset(text, element.offset, name))
            message = f'"{shown}" {wrong}: {remedy}'
            raise ConfigError(str(element.file), mark, f"{element.name} {name}", message)


def _not_finite(value: str) -> bool:
    """Return whether a value begins with numbers, one of which is not finite. No name is `nan`."""
    for word in value.split():
        if _NO_NUMBER.fullmatch(word):
            return True
        if not _DECIMAL.fullmatch(word):
            return False
        if not math.isfinite(float(word)):
            return True
    return False


def _wrong(value: str, bound: NumberBound) -> str:
    """Return the error in an attribute's value; empty: none."""
    numbers = value.split()
    if not numbers:
        return "is empty"
    if len(numbers) > bound.count:
        return f"has {len(numbers)} values"
    return next(filter(None, (_wrong_number(each, bound) for each in numbers)), "")


def _wrong_number(text: str, bound: NumberBound) -> str:
    if not (_WHOLE if bound.whole else _DECIMAL).fullmatch(text):
        return "is no whole number" if bound.whole else "is no finite decimal number"
    number = float(text)
    if not math.isfinite(number):
        return "is no finite number"
    return "" if number in bound else "is out of bounds"


def _in_bytes(value: str) -> str:
    """A size of memory with its unit multiplied out."""
    found = _MEMORY.fullmatch(value.strip())
    return str(int(found[1]) << 10 * " KMGTPE".index(found[2].upper() or " ")) if found else value


def _offset(text: bytes, start: int, name: str) -> int:
    """Return the offset of attribute `name` in the element at `start`; `start` where it is not found."""
    places = _ATTRIBUTE.finditer(text, start)
    return next((place.start() for place in places if place[1] == name.encode()), start)


def _mark(text: bytes, offset: int) -> FilePosition:
    begin = text.rfind(b"\n", 0, offset) + 1
    column = len(text[begin:offset].decode("utf-8", "replace")) + 1
    return FilePosition(text.count(b"\n", 0, offset) + 1, column)
