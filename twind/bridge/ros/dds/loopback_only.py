"""Restriction of Cyclone DDS's ports to this machine, since it binds them on every address.

Its setting of the interface only determines where it sends. No setting of version 11 determines where it
listens. So each of its sockets is bound to the loopback device as well: the kernel then delivers no packet
that came by a network.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Collection
from pathlib import Path

_OPEN = Path("/proc/self/fd")  # Linux; without it nothing is closed, and that is reported
_LOOPBACK = b"lo\0"


def sockets() -> set[int]:
    """Return the descriptors of this process that are sockets."""
    if not _OPEN.is_dir():
        return set()
    return {int(each.name) for each in _OPEN.iterdir() if _target(each).startswith("socket:")}


def keep_here(opened: Collection[int], tell: Callable[[str], None]) -> None:
    """Bind the UDP sockets of these to the loopback device, so that only this machine reaches them.

    `tell` receives a line where that fails.
    """
    if not hasattr(socket, "SO_BINDTODEVICE"):
        tell("dds: its ports are open to other machines, no packet goes there; a firewall closes them")
        return
    for descriptor in opened:
        try:
            with socket.socket(fileno=os.dup(descriptor)) as found:
                if (found.family, found.type) == (socket.AF_INET, socket.SOCK_DGRAM):
                    found.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, _LOOPBACK)
        except OSError as error:
            tell(f"dds: a port may be open to other machines ({error}); a firewall closes it")


def _target(link: Path) -> str:
    try:
        return os.readlink(link)
    except OSError:  # closed in the meantime
        return ""
