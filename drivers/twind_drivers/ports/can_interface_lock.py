"""Exclusive ownership of a CAN interface of the kernel, which itself permits several owners.

The lock is a name in the abstract namespace of Unix sockets (unix(7)). One socket at a time can bind it, it
is visible only in its network namespace, like the interface, and it ends with its process. It excludes other
instances of this driver, not `candump` and `cansend`, which do not use it.
"""

import errno
import os
import socket
from collections.abc import Iterator
from pathlib import Path

from twind_drivers.bus import PortError, PortErrorCause
from twind_drivers.ports.port_holder import command

NAME = "\0twind-can-"  # and the interface
# columns of /proc/net/unix (proc(5)); there the leading zero reads as @
INODE = 6
PATH = 7


class CanInterfaceLock:
    """Lock of an interface by this process, until `close`."""

    def __init__(self, interface: str, *, search: bool = True) -> None:
        """Raises PortError: of kind IN_USE with the owner, or where no sign can be set.

        `search`: for the owner among all processes, which takes tens of milliseconds.
        """
        self._sign = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            self._sign.bind(NAME + interface)
        except OSError as error:
            self._sign.close()
            if error.errno == errno.EADDRINUSE:
                owner = _lock_name(interface) if search else f"another process (`ss -xap | grep {NAME[1:]}`)"
                taken = f"in use by {owner}; stop it first"
                raise PortError(interface, taken, PortErrorCause.IN_USE) from error
            reason = f"its owner cannot be told: {os.strerror(error.errno or 0)}"
            raise PortError(interface, reason) from error

    def close(self) -> None:
        """Release the lock. May be called twice."""
        self._sign.close()


def owners(interface: str, proc: Path = Path("/proc")) -> Iterator[int]:
    """Pids that have the sign of an interface open, as far as this user may see them."""
    try:
        lines = [line.split() for line in (proc / "net/unix").read_text().splitlines()]
    except OSError:
        return
    wanted = "@" + NAME[1:] + interface
    sockets = {f"socket:[{words[INODE]}]" for words in lines if len(words) > PATH and words[PATH] == wanted}
    for entry in proc.iterdir() if sockets else ():
        if not entry.name.isdigit():
            continue
        try:
            held = any(os.readlink(fd) in sockets for fd in (entry / "fd").iterdir())
        except OSError:  # gone, or another user's
            continue
        if held:
            yield int(entry.name)


def _lock_name(interface: str) -> str:
    for pid in owners(interface):
        return f"pid {pid} ({command(pid)})"
    return "another process (not visible to this user)"
