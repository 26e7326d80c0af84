"""An XML file as a tree of elements that know their place. DOCTYPE and entities are refused.

Attributes named `PLACE` carry the place in the source of an expanded xacro file. Knows no schema.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from twind.exceptions import InvalidInput
from twind.plain_file import read_plain
from twind_calibration.model_import.imported_model import import_refused

MAX_BYTES = 8 << 20
MAX_ELEMENTS = 100_000
MAX_DEPTH = 200
PLACE = "twind_place"  # `number of the file:line:column`


@dataclass(slots=True)
class XmlElement:
    """One element. `place` is `file:line:column`, both counted from 1."""

    tag: str
    attributes: dict[str, str]
    place: str
    children: list["XmlElement"] = field(default_factory=list)
    text: str = ""

    def all(self, tag: str) -> list["XmlElement"]:
        """Children with this tag."""
        return [child for child in self.children if child.tag == tag]

    def first(self, tag: str) -> "XmlElement | None":
        """First child with this tag."""
        return next(iter(self.all(tag)), None)

    def walk(self) -> Iterator["XmlElement"]:
        """This element and all below it, in the order of the file."""
        waiting = [self]
        while waiting:
            element = waiting.pop()
            yield element
            waiting.extend(reversed(element.children))

    def refused(self, reason: str) -> InvalidInput:
        """Error at the place of this element."""
        return import_refused(reason, where=self.place)

    def required(self, name: str) -> str:
        """Attribute that must be there and not be empty."""
        value = self.attributes.get(name, "").strip()
        if not value:
            raise self.refused(f"<{self.tag}>: attribute {name!r} is missing; write it")
        return value

    def numbers(self, name: str, count: int, default: Sequence[float] | None = None) -> tuple[float, ...]:
        """Attribute of `count` finite numbers. Without a default it must be there."""
        if default is not None and name not in self.attributes:
            return tuple(default)
        text = self.required(name)
        try:
            values = tuple(float(word) for word in text.split())
        except ValueError:
            values = ()
        if len(values) != count or not all(math.isfinite(value) for value in values):
            wanted = "one number" if count == 1 else f"{count} numbers"
            raise self.refused(f"<{self.tag}>: {name}={text[:80]!r}: {wanted} must stand here")
        return values

    def number(self, name: str, default: float | None = None) -> float:
        """Attribute of one finite number."""
        return self.numbers(name, 1, None if default is None else (default,))[0]


def read_bytes(path: Path, most: int, where: str) -> bytes:
    """All of a file of at most `most` bytes. Raises InvalidInput at the place `where`."""
    try:
        return read_plain(path, most)
    except InvalidInput as error:
        raise import_refused(f"{path}: {error.reason}", where=where) from None
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else "no name of a file"
        raise import_refused(f"{path}: {reason}; give the path of a file that exists", where=where) from None


def read_xml(path: Path) -> XmlElement:
    """Tree of a file. Raises InvalidInput."""
    return parse_xml(read_bytes(path, MAX_BYTES, ""), str(path))


def parse_xml(data: bytes, file: str, sources: Sequence[str] = ()) -> XmlElement:
    """Tree of a document. `sources`: files to which the attributes `PLACE` refer."""
    builder = _TreeBuilder(file, sources)
    parser = expat.ParserCreate()
    builder.attach(parser)
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        reason = f"no well-formed XML: {expat.ErrorString(error.code)}; correct it here"
        raise import_refused(reason, where=f"{file}:{error.lineno}:{error.offset + 1}") from None
    except InvalidInput:
        raise
    except (LookupError, ValueError) as error:  # an encoding that Python does not have
        raise import_refused(f"no readable XML: {error}; save it as UTF-8", where=file) from None
    assert builder.root is not None  # expat has refused a document without an element
    return builder.root


class _TreeBuilder:
    """Handlers of one parser."""

    def __init__(self, file: str, sources: Sequence[str]) -> None:
        self.root: XmlElement | None = None
        self._file = file
        self._sources = sources
        self._open: list[XmlElement] = []
        self._count = 0

    def attach(self, parser: expat.XMLParserType) -> None:
        """Make the parser call this builder."""
        self._parser = parser
        parser.buffer_text = True
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.CharacterDataHandler = self._text
        parser.StartDoctypeDeclHandler = self._refuse_doctype

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        place = self._place(attributes.pop(PLACE, ""))
        self._count += 1
        if self._count > MAX_ELEMENTS or len(self._open) >= MAX_DEPTH:
            bounds = f"{MAX_ELEMENTS} elements, {MAX_DEPTH} levels"
            raise import_refused(f"<{tag}>: larger than a robot: at most {bounds}; shorten it", where=place)
        element = XmlElement(tag, attributes, place)
        if self._open:
            self._open[-1].children.append(element)
        else:
            self.root = element
        self._open.append(element)

    def _end(self, _tag: str) -> None:
        self._open.pop()

    def _text(self, data: str) -> None:
        self._open[-1].text += data

    def _refuse_doctype(self, *_declaration: object) -> None:
        raise import_refused("DOCTYPE and entities are not read; remove the declaration", where=self._here())

    def _here(self) -> str:
        return f"{self._file}:{self._parser.CurrentLineNumber}:{self._parser.CurrentColumnNumber + 1}"

    def _place(self, given: str) -> str:
        number, _, rest = given.partition(":")
        if number.isdecimal() and int(number) < len(self._sources):
            return f"{self._sources[int(number)]}:{rest}"
        if self._sources and self._open:  # made by a macro: the element around it
            return self._open[-1].place
        return self._here()
