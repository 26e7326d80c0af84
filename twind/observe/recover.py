"""Recover a recording that was cut off.

Writes all complete data to a new file, with an index. The old file stays unchanged; no file is overwritten.
"""

import argparse
import contextlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.records import Attachment, Message, Metadata, Schema
from mcap.writer import CompressionType, Writer

from twind.command_line.progress import ProgressLine
from twind.command_line.verb import DONE, Rejected, show
from twind.exceptions import InvalidInput
from twind.observe.recording.mcap_record_scanner import McapContent, McapRecordScanner
from twind.observe.recording.recording_topics import RECOVERED
from twind.observe.writing.record_file import CHUNK, as_text
from twind.ros import STRING, definition_text
from twind.version import __version__

group = "record"
unused_options = ("--socket",)  # it asks no daemon

TEXT = -1  # no schema of a file has this number
TOLD = 1000  # messages between two words of how far it is


@dataclass(frozen=True, slots=True)
class RecoveryResult:
    """Kept and lost parts of a file."""

    out: Path | None  # None: it was whole already
    messages: int
    seconds: float  # from the first message kept to the last
    lost: int  # bytes behind the last whole record
    damaged: int  # chunks inside that do not match their checksums
    why: str  # it was not whole

    def __str__(self) -> str:
        kept = f"{self.messages} messages, {self.seconds:.2f} s"
        if self.out is None:
            return f"whole already: {kept}"
        unwritten = "and what was not on the disk yet, half a second"
        lost = f"lost: {self.lost} bytes at the end ({self.why}), {unwritten}"
        if self.damaged:
            lost += f", {self.damaged} damaged chunks"
        return f"{self.out}\nkept: {kept}\n{lost}"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `twindctl recover`."""
    parser.add_argument("file", metavar="FILE", type=Path, help="the .mcap file that was cut")
    parser.add_argument(
        "--out", metavar="FILE", type=Path, help="default: FILE with `-recovered` in its name"
    )


def run(options: argparse.Namespace) -> int:
    """Recover; 1 where nothing can be."""
    with ProgressLine(options, "recover") as progress:
        found = recover(
            options.file, options.out, tell=lambda share: progress.update(options.file.name, share)
        )
    data = {
        "file": str(options.file),
        "out": None if found.out is None else str(found.out),
        "messages": found.messages,
        "seconds": round(found.seconds, 6),
        "lost_bytes": found.lost,
        "damaged_chunks": found.damaged,
        "why": found.why or None,
    }
    show(options, data, str(found))
    return DONE


def recover(
    path: Path,
    out: Path | None = None,
    *,
    ros: bool = False,
    tell: Callable[[float], None] = lambda _: None,
    other: str = "file with --out",
) -> RecoveryResult:
    """Write all that is whole of `path` to `out`; nothing if it is whole and no `out` is named.

    `ros`: JSON goes into std_msgs/String, since `ros2 bag` reads no file of two encodings.
    `tell`: receives the completed share, 0..1, now and then. `other`: what names another file.
    Raises Rejected: no MCAP file, an empty one, or `out` exists.
    """
    target = out if out is not None else path.with_name(f"{path.stem}-recovered{path.suffix}")
    try:
        before = _look(path)
        if before.out is None and out is None:
            return before
        return _copy(path, target, ros, tell)
    except InvalidInput as error:
        raise Rejected(str(error)) from None
    except (KeyError, ValueError) as error:
        raise Rejected(f"{path}: it is not as MCAP files are ({type(error).__name__}: {error})") from None
    except FileExistsError:
        raise Rejected(f"{target}: is there already; name another {other}") from None
    except OSError as error:
        raise Rejected(f"{error.filename or target}: {error.strerror}") from None


def _look(path: Path) -> RecoveryResult:
    """As it is; `out` is the path itself where it is not whole."""
    file = McapRecordScanner(path)
    span = _MessageSpan()
    for each in file.contents():
        span.take(each)
    return _found(file, span, path if _explain_damage(file) else None)


def _copy(path: Path, target: Path, ros: bool, tell: Callable[[float], None]) -> RecoveryResult:
    fd = os.open(target, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o640)
    try:
        with open(fd, "wb") as stream:
            found = _rewrite(path, target, stream, ros, tell)
            stream.flush()
            os.fsync(stream.fileno())
    except BaseException:
        with contextlib.suppress(OSError):
            target.unlink()
        raise
    return found


def _rewrite(
    path: Path, target: Path, stream: Any, ros: bool, tell: Callable[[float], None]
) -> RecoveryResult:
    file = McapRecordScanner(path)
    span = _MessageSpan()
    writer = Writer(stream, chunk_size=CHUNK, compression=CompressionType.ZSTD)
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    started = False
    for each in file.contents():
        if not started:  # the header is read by now
            writer.start(profile=file.profile, library=file.library or f"twind {__version__}")
            started = True
        span.take(each)
        if isinstance(each, Metadata):
            writer.add_metadata(each.name, each.metadata)
        elif isinstance(each, Attachment):
            writer.add_attachment(each.create_time, each.log_time, each.name, each.media_type, each.data)
        else:
            if span.messages % TOLD == 0:
                tell(file.kept / file.size)
            number = channels.get(each.channel_id)
            if number is None:
                number = channels[each.channel_id] = _channel(writer, file, each.channel_id, schemas, ros)
            wrap = ros and file.channels[each.channel_id].message_encoding == "json"
            data = as_text(each.data) if wrap else each.data
            writer.add_message(number, each.log_time, data, each.publish_time, each.sequence)
    if not span.messages:
        raise Rejected(f"{path}: no message in it is whole: {file.cut or 'it is empty'}")
    found = _found(file, span, target)
    said = {"lost_bytes": str(found.lost), "damaged_chunks": str(found.damaged), "why": found.why}
    writer.add_metadata(RECOVERED, said)
    writer.finish()
    return found


def _channel(writer: Writer, file: McapRecordScanner, number: int, schemas: dict[int, int], ros: bool) -> int:
    """The new number of a channel. `schemas`: new numbers by old ones, TEXT that of std_msgs/String."""
    channel = file.channels[number]
    wrap = ros and channel.message_encoding == "json"
    kind = TEXT if wrap else channel.schema_id
    if kind not in schemas:
        text = Schema(TEXT, definition_text(STRING).encode(), "ros2msg", STRING)
        schema = text if wrap else file.schemas[kind]
        schemas[kind] = writer.register_schema(schema.name, schema.encoding, schema.data)
    encoding = "cdr" if wrap else channel.message_encoding
    found: int = writer.register_channel(channel.topic, encoding, schemas[kind], channel.metadata)
    return found


class _MessageSpan:
    """Messages, and the times of the first and the last."""

    def __init__(self) -> None:
        self.messages = 0
        self.first = 0
        self.last = 0

    def take(self, each: McapContent) -> None:
        if isinstance(each, Message):
            self.first = each.log_time if not self.messages else min(self.first, each.log_time)
            self.last = max(self.last, each.log_time)
            self.messages += 1


def _found(file: McapRecordScanner, span: _MessageSpan, out: Path | None) -> RecoveryResult:
    seconds = (span.last - span.first) / 1e9
    return RecoveryResult(
        out, span.messages, seconds, file.size - file.kept, file.damaged, _explain_damage(file)
    )


def _explain_damage(file: McapRecordScanner) -> str:
    """It is not whole; empty: it is."""
    if file.cut:
        return file.cut
    if file.damaged:
        return f"chunks are damaged, the first at byte {file.damage}"
    return "" if file.indexed else "it has no index: a full disk may have ended it"
