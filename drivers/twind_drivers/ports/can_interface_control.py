"""A CAN network interface of the kernel: presence, queue length, and a restart that empties the queue.

Frames in the kernel's queue survive the socket that sent them, and leave when another node acknowledges
again. Only taking the interface down empties the queue (source: reports of arms that snapped back to old
goals).
"""

import errno
import fcntl
import os
import socket
import struct
from pathlib import Path

# SIOCGIFFLAGS, SIOCSIFFLAGS (linux/sockios.h)
FLAGS = 0x8913
SET_FLAGS = 0x8914
UP = 0x1  # IFF_UP (linux/if.h)
REQUEST = struct.Struct("=16sH22x")  # struct ifreq: name, flags
LONG = 100  # frames; two cycles of 24 actuators are 48
INTERFACES = Path("/sys/class/net")
CAN_TYPE = 280  # ARPHRD_CAN (linux/if_arp.h)


def present(interface: str) -> bool:
    """Return whether the kernel has the interface."""
    return (INTERFACES / interface).exists()


def interfaces() -> list[str]:
    """Names of all CAN interfaces."""
    return sorted(node.name for node in INTERFACES.glob("*") if _number(node / "type") == CAN_TYPE)


def long_queue(interface: str) -> str:
    """Describe a queue that is too long, and the remedy; empty: its length is right."""
    length = _number(INTERFACES / interface / "tx_queue_len")
    if length <= LONG:
        return ""
    return (
        f"its queue holds {length} frames, so as many old ones can go out when power returns; "
        f"`sudo ip link set {interface} txqueuelen 48`"
    )


def restart(interface: str) -> str:
    """Take the interface down and up; return the reason of a failure, or empty.

    This empties its queue and reconnects a controller that had left the wire.
    """
    name = interface.encode()[:15]
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as asking:
            answer = fcntl.ioctl(asking, FLAGS, REQUEST.pack(name, 0))
            flags = REQUEST.unpack(answer)[1]
            fcntl.ioctl(asking, SET_FLAGS, REQUEST.pack(name, flags & ~UP))
            fcntl.ioctl(asking, SET_FLAGS, REQUEST.pack(name, flags | UP))
    except OSError as error:
        reason = os.strerror(error.errno or 0)
        if error.errno in (errno.EPERM, errno.EACCES):
            reason = "not permitted, it needs CAP_NET_ADMIN"
        return (
            f"{interface} could not be taken down and up ({reason}), so frames that wait in the kernel may "
            f"go out when power returns; `sudo ip link set {interface} down`, then `up`, empties its queue"
        )
    return ""


def _number(file: Path) -> int:
    try:
        return int(file.read_text())
    except (OSError, ValueError):
        return -1
