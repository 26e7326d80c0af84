"""The standard streams of a daemon: closed ones, the journal at the end of one, lines that nobody waits for.

Standard library only; reads JOURNAL_STREAM (systemd.exec(5)).
"""

import os
import select
from contextlib import suppress

PRIORITY = {"debug": 7, "info": 6, "warning": 4, "error": 3}  # the journal's, sd-daemon(3)


def stand_in_for_closed() -> None:
    """Standard streams that were closed become /dev/null: else a port would get their number, and a motor bus
    what is meant for people."""
    for fd in (0, 1, 2):
        try:
            os.fstat(fd)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # the lowest free number: this one


def at_journal(fd: int) -> bool:
    """The journal is at the other end of `fd` (JOURNAL_STREAM=device:inode)."""
    device, _, inode = os.environ.get("JOURNAL_STREAM", "").partition(":")
    try:
        there = os.fstat(fd)
    except OSError:
        return False
    return (device, inode) == (str(there.st_dev), str(there.st_ino))


def lines(fd: int, level: str, text: str) -> str:
    """`text` for whoever reads `fd`: at the journal every line carries its level."""
    if not at_journal(fd):
        return text
    prefix = f"<{PRIORITY[level]}>"
    return prefix + text.replace("\n", f"\n{prefix}")


def write_line(fd: int, level: str, text: str) -> None:
    """`text` and a line's end, now or never: a reader that is too slow, or gone, costs the line alone."""
    data = (lines(fd, level, text) + "\n").encode("utf-8", "backslashreplace")[: select.PIPE_BUF]
    room = select.poll()
    with suppress(OSError):
        room.register(fd, select.POLLOUT)
        if any(events & select.POLLOUT for _, events in room.poll(0)):
            os.write(fd, data)
