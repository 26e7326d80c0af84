"""Standard streams of a daemon: replacement of closed ones, journal levels, lines without a wait.

Standard library only; reads JOURNAL_STREAM (systemd.exec(5)).
"""

import os
import select
from contextlib import suppress

PRIORITY = {"debug": 7, "info": 6, "warning": 4, "error": 3}  # the journal's, sd-daemon(3)


def stand_in_for_closed() -> None:
    """Open /dev/null for standard streams that are closed.

    Otherwise a port would get their number, and messages would go to a motor bus.
    """
    for fd in (0, 1, 2):
        try:
            os.fstat(fd)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # the lowest free number: this one


def at_journal(fd: int) -> bool:
    """Check that the journal reads `fd` (JOURNAL_STREAM=device:inode)."""
    device, _, inode = os.environ.get("JOURNAL_STREAM", "").partition(":")
    try:
        there = os.fstat(fd)
    except OSError:
        return False
    return (device, inode) == (str(there.st_dev), str(there.st_ino))


def lines(fd: int, level: str, text: str) -> str:
    """Return `text` for the reader of `fd`: for the journal every line carries its level."""
    if not at_journal(fd):
        return text
    prefix = f"<{PRIORITY[level]}>"
    return prefix + text.replace("\n", f"\n{prefix}")


def write_line(fd: int, level: str, text: str) -> None:
    """Write `text` as a line without a wait; it is lost if the reader is too slow or gone."""
    data = (lines(fd, level, text) + "\n").encode("utf-8", "backslashreplace")[: select.PIPE_BUF]
    room = select.poll()
    with suppress(OSError):
        room.register(fd, select.POLLOUT)
        if any(events & select.POLLOUT for _, events in room.poll(0)):
            os.write(fd, data)
