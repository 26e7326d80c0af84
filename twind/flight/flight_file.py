"""Flight file: one file per bug report, written whole or not at all; reading detects a file that was cut.

A magic, a head in msgpack (`meta` and the table of sections), then the sections, packed by zlib. A save
leaves the old file or the new one, never a part.
"""

import contextlib
import os
import struct
import zlib
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from typing import Annotated, Any

import msgspec

from twind.briefing import Briefing
from twind.flight.flight_records import LAST, NO_BUS, FlightContents, PackedFlight, broken, unusable
from twind.new_file import open_new
from twind.plain_file import open_plain

MOST = 128 << 20  # bytes of all sections, unpacked: twice the largest ring
HEAD_MOST = 1 << 20  # bytes of a head
SECTIONS = {"briefing", "entries", *(f"kept {bus}" for bus in range(NO_BUS))}

MAGIC = b"twind flight 1\n\0"
SECOND = 1_000_000_000  # ns
HEAD = struct.Struct("<II")  # bytes of the head, their CRC-32
_LEVEL = 3  # of zlib: a tenth smaller at the next levels, for twice the time
_FOREIGN = (msgspec.MsgspecError, UnicodeDecodeError, RecursionError)  # the last: endless nesting


class FlightMeta(msgspec.Struct):
    """Keys of `meta` that readers rely on. Others may stand beside them."""

    buses: tuple[str, ...] = ()  # as entries number them
    wall_ns: Annotated[int, msgspec.Meta(ge=0, le=LAST * SECOND)] = 0  # when the two clocks were read
    monotonic: float = 0.0  # s
    reason: str = ""
    code: str = ""
    robot: str = ""
    individual: str | None = None
    mode: str | None = None
    state: str | None = None

    def __post_init__(self) -> None:
        if not 0.0 <= self.monotonic <= LAST:  # NaN passes a bound of msgspec
            raise ValueError(f"monotonic: {self.monotonic:g} is outside 0 to {LAST} s")


class _FlightHeader(msgspec.Struct):
    """Head of a flight file: meta and the table of its sections."""

    meta: dict[str, Any]
    sections: list[tuple[str, int, int]]  # name, bytes in the file, bytes unpacked


@dataclass(frozen=True)
class LoadedFlight:
    """A flight file, read."""

    meta: dict[str, Any]  # when, why, of which robot
    briefing: Briefing
    contents: FlightContents


def save(
    path: Path | str, meta: dict[str, Any], briefing: bytes, contents: FlightContents | PackedFlight
) -> None:
    """Write `path`, mode 0640 less what the umask takes, over one that is there.

    `briefing`: a Briefing in msgpack. It is on the disk on return; a power cut leaves it whole or not there.
    Raises OSError; then nothing of it is left.
    """
    path = Path(path)
    beside = path.with_name(f".{path.name}.tmp")
    draft(beside, meta, briefing, contents)
    try:
        os.replace(beside, path)
    except BaseException:
        beside.unlink(missing_ok=True)
        raise
    settle(path.parent)


def draft(
    path: Path, meta: dict[str, object], briefing: bytes, contents: FlightContents | PackedFlight
) -> None:
    """Write `path` itself, else as `save`: a power cut may leave half of it."""
    packed = contents.pack() if isinstance(contents, FlightContents) else contents
    parts = [("briefing", briefing), ("entries", packed.entries)]
    parts += [(f"kept {bus}", data) for bus, data in packed.kept.items()]
    sections = [(name, zlib.compress(data, _LEVEL), len(data)) for name, data in parts]
    head = msgspec.msgpack.encode(
        _FlightHeader(meta, [(name, len(data), raw) for name, data, raw in sections])
    )
    pieces = [MAGIC, HEAD.pack(len(head), zlib.crc32(head)), head, *(data for _, data, _ in sections)]
    fd = open_new(path, 0o640)
    try:
        with open(fd, "wb") as file:
            file.writelines(pieces)
            file.flush()
            os.fsync(file.fileno())
    except BaseException:
        with contextlib.suppress(OSError):
            path.unlink()
        raise


def settle(folder: Path) -> None:
    """Sync the directory `folder`, so that its file names are on the disk (fsync). Raises OSError."""
    fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)


def about(path: Path | str) -> dict[str, object]:
    """Return the `meta` of a flight file alone, which takes no time. Raises as `load`."""
    with open_plain(path) as file:
        return _read_head(str(path), file).meta


def load(path: Path | str) -> LoadedFlight:
    """Read a flight file. Raises InvalidInput (cut, damaged, or another format), OSError (not readable)."""
    name = str(path)
    with open_plain(path) as file:
        head = _read_head(name, file)
        if any(size < 0 for _, size, _ in head.sections):
            raise broken(name, "a section of it has a negative size")
        size = sum(size for _, size, _ in head.sections)
        behind = os.fstat(file.fileno()).st_size - file.tell() - size
        if behind > 0:
            raise broken(name, f"{behind} bytes lie behind its end")
        if size > MOST:
            raise broken(name, f"its sections claim {size} bytes: at most {MOST}")
        sections = file.read(size)
    raw = _unpack(name, sections, head.sections)
    try:
        briefing = msgspec.msgpack.decode(raw.pop("briefing"), type=Briefing)
        entries = raw.pop("entries")
        kept = {int(key.removeprefix("kept ")): part for key, part in raw.items()}
    except (*_FOREIGN, KeyError) as error:
        raise broken(name, f"its content has another format ({error})") from None
    return LoadedFlight(head.meta, briefing, PackedFlight(kept, entries).parse(name))


def _read_head(path: str, file: BufferedReader) -> _FlightHeader:
    """Read the head alone. Raises InvalidInput."""
    if file.read(len(MAGIC)) != MAGIC:
        raise unusable(path, "is no flight file of this version", "`twindctl dump` writes one")
    start = file.read(HEAD.size)
    size, crc = HEAD.unpack(start) if len(start) == HEAD.size else (1, 0)
    if size > HEAD_MOST:
        raise broken(path, f"its head claims {size} bytes: at most {HEAD_MOST}")
    data = file.read(size)
    if len(data) != size or zlib.crc32(data) != crc:
        raise broken(path, "its head is cut or damaged")
    try:
        head = msgspec.msgpack.decode(data, type=_FlightHeader)
        msgspec.convert(head.meta, FlightMeta)
    except _FOREIGN as error:
        raise broken(path, f"its head has another format ({error})") from None
    return head


def _unpack(path: str, data: bytes, sections: list[tuple[str, int, int]]) -> dict[str, bytes]:
    """Return the sections by name. Raises InvalidInput: cut or damaged."""
    at = 0
    raw = dict[str, bytes]()
    room = MOST
    for name, size, unpacked in sections:
        if name not in SECTIONS or name in raw:
            raise broken(path, f"{name[:40]!r} is no section of it, or there twice")
        part = zlib.decompressobj()
        if not 0 <= unpacked <= room:
            raise broken(path, f"its section {name} claims {unpacked} bytes: {room} are left of {MOST}")
        room -= unpacked
        try:
            raw[name] = part.decompress(data[at : at + size], unpacked + 1)
        except zlib.error:
            raise broken(path, f"its section {name} is damaged") from None
        if not part.eof or part.unused_data or len(raw[name]) != unpacked:
            raise broken(path, f"its section {name} is cut")
        at += size
    return raw
