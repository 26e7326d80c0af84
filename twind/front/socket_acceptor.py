"""Acceptor of a front's listening sockets: accepts clients, checks that clients reach them. Front process.

A socket whose file was removed or replaced takes the e-stop away from every new client. It is bound again
where that is possible; else the loop receives the reason, holds and refuses motion.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from twind.exceptions import OperationFailed
from twind.link import Reachable, Rebound
from twind.listening_sockets import Listener, listen
from twind.protocol.socket_paths import SYSTEM

if TYPE_CHECKING:
    from twind.front.loop_connection import LoopConnection

ROLES = {"control": "operator", "observe": "observer"}


@dataclass(slots=True)
class _Door:
    """One listening socket. `watched`: the event loop reports its clients."""

    name: str
    listener: Listener
    checked: bool  # its file is known, so that a removed one is noticed
    watched: bool = False


class SocketAcceptor:
    """Listening sockets by their names."""

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        link: LoopConnection,
        accept: Callable[[socket.socket, str], None],
    ) -> None:
        """Make the sockets; `accept` is called with a client's socket, and the role that it gives."""
        self._loop = loop
        self._link = link
        self._accept = accept
        self._doors: list[_Door] = []
        self._open = False
        self._rebound: list[str] = []  # paths that the loop has no report of yet
        self._reported: str | None = None  # the last reason that was sent to the loop; None: none was

    def add(self, name: str, listener: Listener, *, checked: bool) -> None:
        """Accept from `listener` once clients can be served. `checked`: its file is known."""
        listener.bound.setblocking(False)
        self._doors.append(_Door(name, listener, checked))
        if self._open:
            self.open()

    def open(self) -> None:
        """Accept clients from every socket from now on, also from those that rested."""
        self._open = True
        for door in self._doors:
            if not door.watched:
                door.watched = True
                sock = door.listener.bound
                self._loop.add_reader(sock, self._accept, sock, ROLES[door.name])

    def rest(self, sock: socket.socket) -> None:
        """Accept none from this socket until `open` is called: its client stays in the queue."""
        for door in self._doors:
            if door.listener.bound is sock:
                self._unwatch(door)

    def close(self) -> None:
        """Accept no more clients. New connections wait for the next front."""
        for door in self._doors:
            self._unwatch(door)
            door.listener.close()
        self._doors = []

    def check(self) -> None:
        """Bind again what was removed, and report to the loop what changed. Nothing before `open`.

        Nothing after the loop's end either: a daemon that follows may bind the same paths.
        """
        if not self._open or not self._doors or self._link.is_closed:
            return
        missing = "; ".join(reason for door in self._doors if (reason := self._wrong(door)))
        if missing != self._reported or self._rebound:
            self._link.owe(Reachable(missing=missing, rebound=self._rebound))
            self._reported = missing
            self._rebound = []

    def _wrong(self, door: _Door) -> str:
        """Return why no client reaches this socket; "": it is in place, or bound again."""
        path = door.listener.path
        if not door.checked or path is None or door.listener.in_place:
            return ""
        if not door.listener.own:
            return f"{path}: no client can connect, its file was removed or replaced; {_by_manager(path)}"
        try:
            made = Listener.of(_bound_again(path.parent, door.name), own=True)
        except (OperationFailed, OSError) as error:
            return f"no client can connect: {error} (it is tried again)"
        if not self._link.send(Rebound(name=door.name, label=made.label), made.bound.fileno()):
            made.close()  # the next check finds its file stale, and binds again
            return f"{path}: no client can connect: the loop does not take the new socket"
        self._unwatch(door)
        door.listener.close()
        door.listener = made
        made.bound.setblocking(False)
        self._rebound.append(str(path))
        self.open()
        return ""

    def _unwatch(self, door: _Door) -> None:
        self._loop.remove_reader(door.listener.bound)
        door.watched = False


def _by_manager(path: Path) -> str:
    """Return the command that restores a socket of the service manager: the units of this daemon alone."""
    at = f"@{path.parent.name}" if str(path.parent.parent) == SYSTEM else ""
    units = f"twind-control{at}.socket twind-observe{at}.socket twind{at}.service"
    return (
        "only the service manager can bind this socket again: restart its .socket unit together with the "
        f"daemon: `systemctl restart {units}` lowers the robot first"
    )


def _bound_again(folder: Path, name: str) -> socket.socket:
    """A new socket there, tried twice: a folder that is being removed can go between its check and `bind`.

    Raises OperationFailed, OSError.
    """
    try:
        return listen(folder, name)
    except OperationFailed:
        return listen(folder, name)
