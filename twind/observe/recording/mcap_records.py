"""The records of an .mcap file one after the other, as far as they are whole: also of a file that was cut.

No index is used, so a file without its end gives all that was written of it.
"""

import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

from twind.exceptions import InvalidInput

MAGIC = b"\x89MCAP0\r\n"
LARGEST = 64 << 20  # bytes of a record, and of what a chunk holds: whoever made the file wrote its sizes
_HEAD = struct.Struct("<BQ")  # opcode, bytes that follow
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_HEADER = 1
_FOOTER = 2
_SCHEMA = 3
_CHANNEL = 4
_MESSAGE_CODE = 5
_CHUNK = 6
_ATTACHMENT = 9
_METADATA = 12


class McapMessage(NamedTuple):
    """One message. Times in ns."""

    channel: int
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


@dataclass(frozen=True, slots=True)
class McapSchema:
    """What the messages of a channel are."""

    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True, slots=True)
class McapChannel:
    """Where messages come from. `schema` is its number, 0: none."""

    topic: str
    encoding: str
    schema: int
    metadata: dict[str, str]


@dataclass(frozen=True, slots=True)
class McapAttachment:
    """A file in the file. Times in ns."""

    name: str
    media_type: str
    log_time: int
    create_time: int
    data: bytes


@dataclass(frozen=True, slots=True)
class McapMetadata:
    """Words by name."""

    name: str
    data: dict[str, str]


class McapScanner:
    """One pass over a file. `schemas` and `channels` (by number), `profile`, `library` fill while it is read.

    After the pass: `cut`, why and where it ended too early (empty: it is whole), `kept` bytes up to there,
    `indexed`: it has an index, which is written last; and `damaged`, how many chunks did not match their
    checksum, or were larger than LARGEST, and were left out.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.size = os.stat(path).st_size
        self.profile = self.library = self.cut = ""
        self.schemas: dict[int, McapSchema] = {}
        self.channels: dict[int, McapChannel] = {}
        self.kept = self.damaged = 0
        self.indexed = False

    def contents(self) -> Iterator[McapMessage | McapAttachment | McapMetadata]:
        """All that is whole, in the order of the file. Raises InvalidInput, OSError."""
        with open(self.path, "rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                reason = "is no MCAP file: it does not begin with the bytes of one"
                raise InvalidInput(reason, where=str(self.path))
            self.kept = len(MAGIC)
            for code, data in self._records(file):
                try:
                    yield from self._record(code, data)
                except (struct.error, UnicodeDecodeError):
                    self.cut = f"what stands at byte {self.kept} is no record"
                    return
                self.kept = file.tell()
                if code == _FOOTER:
                    end = file.read()
                    self.cut = "" if end == MAGIC else "its last bytes are missing"
                    self.kept += len(end) if end == MAGIC else 0
                    return

    def _records(self, file: BinaryIO) -> Iterator[tuple[int, bytes]]:
        """(opcode, its bytes) of each record that is there to its last byte."""
        while True:
            head = file.read(_HEAD.size)
            if len(head) < _HEAD.size:
                self.cut = f"it ends at byte {self.size} without its index"
                return
            code, length = _HEAD.unpack(head)
            if code == 0 or length > self.size - file.tell():
                self.cut = f"the record at byte {self.kept} is not whole"
                return
            if length > LARGEST:
                self.damaged += 1
                file.seek(length, os.SEEK_CUR)
                continue
            yield code, file.read(length)

    def _record(self, code: int, data: bytes) -> Iterator[McapMessage | McapAttachment | McapMetadata]:
        if code == _CHUNK:
            yield from self._chunk(data)
        elif code == _MESSAGE_CODE:
            yield _message(data, 0, len(data))
        elif code == _METADATA:
            source = _RecordFields(data)
            yield McapMetadata(source.text(), source.table())
        elif code == _ATTACHMENT:
            source = _RecordFields(data)
            log_time, create_time = source.numbers("QQ")
            name, media_type, (size,) = source.text(), source.text(), source.numbers("Q")
            yield McapAttachment(name, media_type, log_time, create_time, source.bytes(size))
        elif code == _HEADER:
            source = _RecordFields(data)
            self.profile = source.text()
            self.library = source.text()
        elif code == _FOOTER:
            start, *_ = _RecordFields(data).numbers("QQI")
            self.indexed = start > 0
        else:
            self._described(code, data)

    def _described(self, code: int, data: bytes) -> None:
        source = _RecordFields(data)
        if code == _SCHEMA:
            (number,) = source.numbers("H")
            name, encoding, (size,) = source.text(), source.text(), source.numbers("I")
            self.schemas[number] = McapSchema(name, encoding, source.bytes(size))
        elif code == _CHANNEL:
            number, schema = source.numbers("HH")
            topic = source.text()
            encoding = source.text()
            self.channels[number] = McapChannel(topic, encoding, schema, source.table())

    def _chunk(self, data: bytes) -> Iterator[McapMessage]:
        source = _RecordFields(data)
        *_, size, crc = source.numbers("QQQI")
        compression, (length,) = source.text(), source.numbers("Q")
        records = _unpacked(compression, source.bytes(length), size)
        if records is None or len(records) != size or (crc and zlib.crc32(records) != crc):
            self.damaged += 1
            return
        at = 0
        while at < size:
            code, length = _HEAD.unpack_from(records, at)
            at += _HEAD.size
            if code == _MESSAGE_CODE:
                yield _message(records, at, at + length)
            else:
                self._described(code, records[at : at + length])
            at += length


def _message(data: bytes, at: int, end: int) -> McapMessage:
    channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(data, at)
    return McapMessage(channel, sequence, log_time, publish_time, data[at + _MESSAGE.size : end])


def _unpacked(compression: str, data: bytes, size: int) -> bytes | None:
    """What a chunk holds, of which its head says that it has `size` bytes; None where that cannot be had."""
    if size > LARGEST:
        return None
    if compression == "zstd":
        import zstandard

        try:
            if zstandard.frame_content_size(data) not in (-1, size):  # this and not ours would be allocated
                return None
            return zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
        except zstandard.ZstdError:
            return None
    if compression == "lz4":
        from lz4 import frame

        try:
            unpacked: bytes = frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
        except RuntimeError:
            return None
        return unpacked
    return data if compression == "" else None


class _RecordFields:
    """Fields of a record. Raises struct.error where they end too early."""

    def __init__(self, data: bytes) -> None:
        self._stream = BytesIO(data)

    def numbers(self, letters: str) -> tuple[int, ...]:
        form = struct.Struct(f"<{letters}")
        return form.unpack(self._stream.read(form.size))

    def bytes(self, size: int) -> bytes:
        data = self._stream.read(size)
        if len(data) != size:
            raise struct.error(f"{size} bytes, of which {len(data)} are there")
        return data

    def text(self) -> str:
        (size,) = self.numbers("I")
        return self.bytes(size).decode()

    def table(self) -> dict[str, str]:
        (size,) = self.numbers("I")
        end = self._stream.tell() + size
        found = {}
        while self._stream.tell() < end:
            key = self.text()
            found[key] = self.text()
        return found
