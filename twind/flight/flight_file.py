"""Flight file: one file per bug report, written whole or not at all; reading detects a file that was cut.

A magic, a head in msgpack (`meta` and the table of sections), then the sections, packed by zlib. A save
leaves the old file or the new one, never a part.
"""

import contextlib
import os
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from twind.briefing import Briefing
from twind.flight.flight_records import NO_BUS, FlightContents, PackedFlight, broken, unusable

MOST = 128 << 20  # bytes of all sections, unpacked: twice the largest ring
HEAD_MOST = 1 << 20  # bytes of a head
SECTIONS = {"briefing", "entries", *(f"kept {bus}" for bus in range(NO_BUS))}

MAGIC = b"twind flight 1\n\0"
HEAD = struct.Struct("<II")  # bytes of the head, their CRC-32
_LEVEL = 3  # of zlib: a tenth smaller at the next levels, for twice the time
_FOREIGN = (msgspec.MsgspecError, RecursionError)  # the second: input with endless nesting


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
    flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_CLOEXEC
    fd = os.open(path, flags, 0o640)
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
    with open(path, "rb") as file:
        _require_magic(str(path), file.read(len(MAGIC)))
        start = file.read(HEAD.size)
        size = HEAD.unpack(start)[0] if len(start) == HEAD.size else 0
        return _open(str(path), start + file.read(min(size, HEAD_MOST)))[0].meta


def load(path: Path | str) -> LoadedFlight:
    """Read a flight file. Raises InvalidInput (cut, damaged, or another format), OSError (not readable)."""
    name = str(path)
    with open(path, "rb") as file:
        _require_magic(name, file.read(len(MAGIC)))
        data = file.read()
    head, sections = _open(name, data)
    raw = _unpack(name, sections, head.sections)
    try:
        briefing = msgspec.msgpack.decode(raw.pop("briefing"), type=Briefing)
        entries = raw.pop("entries")
        kept = {int(key.removeprefix("kept ")): part for key, part in raw.items()}
    except (*_FOREIGN, KeyError) as error:
        raise broken(name, f"its content has another format ({error})") from None
    return LoadedFlight(head.meta, briefing, PackedFlight(kept, entries).parse(name))


def _require_magic(path: str, found: bytes) -> None:
    if found != MAGIC:
        raise unusable(path, "is no flight file of this version", "`twindctl dump` writes one")


def _open(path: str, data: bytes) -> tuple[_FlightHeader, bytes]:
    """Return the head, and the bytes after it."""
    size, crc = HEAD.unpack_from(data) if len(data) >= HEAD.size else (1, 0)
    head = data[HEAD.size : HEAD.size + size]
    if size > HEAD_MOST:
        raise broken(path, f"its head claims {size} bytes: at most {HEAD_MOST}")
    if len(head) != size or zlib.crc32(head) != crc:
        raise broken(path, "its head is cut or damaged")
    try:
        return msgspec.msgpack.decode(head, type=_FlightHeader), data[HEAD.size + size :]
    except _FOREIGN as error:
        raise broken(path, f"its head has another format ({error})") from None


def _unpack(path: str, data: bytes, sections: list[tuple[str, int, int]]) -> dict[str, bytes]:
    """Return the sections by name. Raises InvalidInput: cut, damaged, or with bytes after them."""
    at = 0
    raw = dict[str, bytes]()
    room = MOST
    for name, size, unpacked in sections:
        if name not in SECTIONS or name in raw:
            raise broken(path, f"{name[:40]!r} is no section of it, or there twice")
        part = zlib.decompressobj()
        if not (0 <= unpacked <= room and size >= 0):
            raise broken(path, f"its section {name} claims {unpacked} bytes: {room} are left of {MOST}")
        room -= unpacked
        try:
            raw[name] = part.decompress(data[at : at + size], unpacked + 1)
        except zlib.error:
            raise broken(path, f"its section {name} is damaged") from None
        if not part.eof or part.unused_data or len(raw[name]) != unpacked:
            raise broken(path, f"its section {name} is cut")
        at += size
    if at != len(data):
        raise broken(path, f"{len(data) - at} bytes lie behind its end")
    return raw
