"""One .mcap file that is being written: whole up to half a second ago, whatever ends process or power."""

import contextlib
import fcntl
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mcap.data_stream import RecordBuilder
from mcap.records import DataEnd, Footer
from mcap.writer import CompressionType, Writer

from twind.observe.recording.mcap_record_scanner import MAGIC
from twind.observe.writing.record_schemas import ROS, json_schemas
from twind.ros import STRING, definition_text, encode
from twind.version import __version__

CHUNK = 64 << 10  # bytes: a larger one takes longer to write, and more is lost with it
PROFILE = "ros2"


class BufferedFile:
    """Bytes to a new file. They wait until `flush`: few writes cost less.

    Locked while it is open, so that no other process removes it as an old one.
    """

    def __init__(self, path: Path) -> None:
        """Raises OSError."""
        self.size = 0  # bytes, those that wait included
        self._waiting = bytearray()
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o640)
        with contextlib.suppress(OSError):  # where a file system has no locks it goes without
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        with contextlib.suppress(OSError):
            os.fsync(folder)  # else a power cut may leave no name
        os.close(folder)

    def write(self, data: bytes | bytearray | memoryview) -> int:
        """Take all of it."""
        self._waiting += data
        self.size += len(data)
        return len(data)

    def tell(self) -> int:
        """Bytes so far."""
        return self.size

    def flush(self) -> None:
        """Write all that waits. Raises OSError."""
        waiting = self._waiting
        self._waiting = bytearray()
        self.pour(memoryview(waiting))

    def pour(self, data: memoryview) -> None:
        """Hand it to the system, in as many parts as that takes it. Raises OSError."""
        while data:
            data = data[os.write(self._fd, data) :]

    def sync(self) -> None:
        """Wait until it is on the disk. Raises OSError."""
        os.fdatasync(self._fd)

    def cut(self, size: int) -> None:
        """Leave `size` bytes. Raises OSError."""
        self._waiting.clear()
        os.ftruncate(self._fd, size)
        os.lseek(self._fd, size, os.SEEK_SET)
        self.size = size

    def close(self) -> None:
        """Let go of it; the lock goes too."""
        os.close(self._fd)


class RecordFile:
    """An open recording. Every method but `abandon` may raise OSError; then `abandon` it."""

    def __init__(
        self,
        path: Path,
        about: Mapping[str, str],
        attachments: Mapping[str, tuple[str, bytes]],
        time_ns: int,
        *,
        disk: Any = None,
        ros: bool = False,
    ) -> None:
        """`attachments`: media type and bytes by name. `disk`: what it is written to, in place of a file.

        `ros`: JSON goes into std_msgs/String, since `ros2 bag` reads no file of two encodings.
        """
        self.path = path
        self.began = time_ns
        self.messages = 0
        self._disk = BufferedFile(path) if disk is None else disk
        self._writer = Writer(self._disk, chunk_size=CHUNK, compression=CompressionType.ZSTD)
        self._ros = ros
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._json = json_schemas()
        self._whole = self._kept = 0  # bytes and messages up to the end of the last whole chunk
        try:
            self._writer.start(profile=PROFILE, library=f"twind {__version__}")
            self._writer.add_metadata("twind", dict(about))
            for name, (media_type, data) in attachments.items():
                self._writer.add_attachment(time_ns, time_ns, name, media_type, data)
            self.flush()
        except OSError:
            self._disk.close()
            raise

    @property
    def size(self) -> int:
        """Bytes in the file; what is in the open chunk comes to it."""
        size: int = self._disk.size
        return size

    def write(self, topic: str, time_ns: int, data: bytes) -> None:
        """One message."""
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._channels[topic] = self._open(topic)
        if self._ros and topic not in ROS:
            data = as_text(data)
        self._writer.add_message(channel, time_ns, data, time_ns, self.messages & 0xFFFFFFFF)
        self.messages += 1

    def flush(self) -> None:
        """Close the chunk: all messages so far are in the file, and on the disk."""
        self._writer.flush()
        self._whole = self._disk.size
        self._kept = self.messages
        self._disk.sync()

    def metadata(self, name: str, data: Mapping[str, str]) -> None:
        """A metadata record."""
        self._writer.add_metadata(name, dict(data))

    def finish(self) -> None:
        """Write the index and close."""
        self._writer.flush()
        self._whole = self._disk.size
        self._kept = self.messages
        self._writer.finish()
        self._disk.flush()
        self._disk.sync()
        self._disk.close()

    def abandon(self) -> int:
        """Close after an error: what is whole stays, with an end that readers know; without an index.

        How many messages are lost.
        """
        with contextlib.suppress(OSError):  # not even that fits: `twindctl recover` makes it whole
            self._disk.cut(self._whole)
            self._disk.write(_end())
            self._disk.flush()
        self._disk.close()
        return self.messages - self._kept

    def _open(self, topic: str) -> int:
        """The number of a topic's channel, which is new."""
        kind = ROS.get(topic, STRING if self._ros else "")
        about = {} if topic in ROS else {"jsonschema": self._json[topic]}
        if kind and kind not in self._schemas:
            text = definition_text(kind).encode()
            self._schemas[kind] = self._writer.register_schema(kind, "ros2msg", text)
        encoding = "cdr" if kind else "json"
        number: int = self._writer.register_channel(topic, encoding, self._schemas.get(kind, 0), about)
        return number


def as_text(data: bytes) -> bytes:
    """JSON as a message of std_msgs/String."""
    return encode(STRING, {"data": data.decode()})


def _end() -> bytes:
    """The last records of a file without an index."""
    builder = RecordBuilder()
    DataEnd(0).write(builder)
    Footer(summary_start=0, summary_offset_start=0, summary_crc=0).write(builder)
    return bytes(builder.end()) + MAGIC
