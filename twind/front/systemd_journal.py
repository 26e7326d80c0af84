"""Journal of systemd: entries with fields, as datagrams ("Native Journal Protocol")."""

import socket
import struct
from collections.abc import Mapping
from typing import Any

from twind import standard_streams

SOCKET = "/run/systemd/journal/socket"
PATIENCE = 1.0  # s that a journal which reads nothing is waited for, by the log's own thread
PRIORITY = {**standard_streams.PRIORITY, "critical": 2}
IDENTIFIER = "twind"


def datagram(fields: Mapping[str, object]) -> bytes:
    """One entry. Names that the journal does not take, and values that are None, are left out."""
    parts = [_field("SYSLOG_IDENTIFIER", IDENTIFIER)]
    parts += [_field(name, value) for name, value in fields.items() if value is not None and _is_name(name)]
    return b"".join(parts)


def _is_name(name: str) -> bool:
    """Capitals, digits and underscores, beginning with a capital, 64 at most."""
    plain = name.replace("_", "A")
    return (
        0 < len(name) <= 64
        and name[0].isalpha()
        and plain.isascii()
        and plain.isalnum()
        and name.upper() == name
    )


def _field(name: str, value: Any) -> bytes:
    """Encode `NAME=value`; a value of several lines with its length before it."""
    data = str(value).encode("utf-8", "backslashreplace")
    if b"\n" not in data:
        return name.encode() + b"=" + data + b"\n"
    return name.encode() + b"\n" + struct.pack("<Q", len(data)) + data + b"\n"


class SystemdJournal:
    """Socket of the journal, opened when it is needed. Used by one thread."""

    def __init__(self, path: str = SOCKET) -> None:
        self._path = path
        self._socket: socket.socket | None = None

    def send(self, entry: bytes) -> bool:
        """False: it is not there, does not read, or does not take an entry of that size."""
        try:
            if self._socket is None:
                self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
                self._socket.settimeout(PATIENCE)
            self._socket.sendto(entry, self._path)
        except OSError:
            return False
        return True

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
