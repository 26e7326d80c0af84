"""Sockets and descriptors that the service manager hands over at start (sd_listen_fds(3)). Loop's process."""

import os
import socket
from collections.abc import Mapping
from dataclasses import dataclass, field

from twind.listening_sockets import NAMES
from twind.standard_streams import write_line

WRECK = "flight"  # FDNAME of the flight recorder that a former daemon stored
_FIRST = 3  # SD_LISTEN_FDS_START


@dataclass(frozen=True, slots=True)
class InheritedDescriptors:
    """Descriptors from the service manager, which this process closes.

    `close` closes the sockets; `FormerFlightRecorder` closes the memfd.
    """

    sockets: Mapping[str, socket.socket] = field(default_factory=dict)  # listening sockets by name
    wreck: int | None = None  # memfd of a former daemon

    def close(self) -> None:
        """Close the sockets."""
        for listener in self.sockets.values():
            listener.close()


def handed_over() -> InheritedDescriptors:
    """Return the descriptors of the service manager, by FileDescriptorName= or FDNAME=; clears LISTEN_*.

    A socket by another name is reported and left to the manager: it is neither served nor closed.
    """
    count = os.environ.get("LISTEN_FDS", "")
    mine = os.environ.get("LISTEN_PID", "")
    names = os.environ.get("LISTEN_FDNAMES", "").split(":")
    for key in ("LISTEN_FDS", "LISTEN_PID", "LISTEN_FDNAMES"):
        os.environ.pop(key, None)
    if not count.isdigit() or mine != str(os.getpid()):
        return InheritedDescriptors()
    found = {}
    wreck = None
    handed = range(_FIRST, _FIRST + int(count))
    for fd in handed:
        os.set_inheritable(fd, False)
    for fd, name in zip(handed, names, strict=False):
        if name in NAMES:
            found[name] = socket.socket(fileno=fd)
        elif name == WRECK:
            if wreck is not None:
                os.close(wreck)
            wreck = fd
        else:
            names_text = " or ".join(NAMES)
            message = f"a socket named {name!r} was handed over, and is not served"
            write_line(
                2, "warning", f"twind: {message}: FileDescriptorName= of its unit must be {names_text}"
            )
    return InheritedDescriptors(found, wreck)
