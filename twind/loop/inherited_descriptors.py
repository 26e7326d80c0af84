"""Sockets and descriptors that the service manager hands over at start (sd_listen_fds(3)). Loop's process."""

import os
import socket
from collections.abc import Mapping
from dataclasses import dataclass, field

from twind.listening_sockets import NAMES
from twind.standard_streams import write_line

WRECK = "flight"  # FDNAME of what the loop stores: the flight recorder of a daemon that is gone
_FIRST = 3  # SD_LISTEN_FDS_START


@dataclass(frozen=True, slots=True)
class InheritedDescriptors:
    """What the service manager handed over, ours to close; the memfd by who takes it (`CrashRecording`)."""

    sockets: Mapping[str, socket.socket] = field(default_factory=dict)  # that it listens on, by name
    wreck: int | None = None  # memfd of a daemon before us

    def close(self) -> None:
        """Let go of the sockets."""
        for listener in self.sockets.values():
            listener.close()


def handed_over() -> InheritedDescriptors:
    """What the service manager hands over, by FileDescriptorName= or FDNAME=; clears LISTEN_*.

    A socket by another name is told, and left to the manager: we neither serve nor close it.
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
            known = " or ".join(NAMES)
            said = f"a socket named {name!r} was handed over, and nobody serves it"
            write_line(2, "warning", f"twind: {said}: FileDescriptorName= of its unit must be {known}")
    return InheritedDescriptors(found, wreck)
