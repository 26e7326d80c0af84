"""sd_notify: one datagram a message to $NOTIFY_SOCKET (sd_notify(3)). Without it, nothing.

READY does not say that the servos answer: an unplugged robot must not fail the start. The status does.
"""

import array
import contextlib
import os
import socket

STATUS = 1.0  # s between two status lines: a servo that comes and goes must not flood the manager


class Notifier:
    """Tells the service manager; never blocks and never raises: a lost notice must not cost a tick."""

    def __init__(self, environment: dict[str, str] | None = None) -> None:
        env = dict(os.environ) if environment is None else environment
        address = env.get("NOTIFY_SOCKET", "")
        self._socket: socket.socket | None = None
        self.watchdog = self._interval(env)  # s between WATCHDOG=1; inf: not wanted
        self._next = self._status_next = 0.0
        self._status = ""
        self._ready = False
        if address:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)
            self._address = "\0" + address[1:] if address.startswith("@") else address

    @staticmethod
    def _interval(env: dict[str, str]) -> float:
        wanted = env.get("WATCHDOG_USEC", "")
        mine = env.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        return int(wanted) / 4e6 if mine and wanted.isdecimal() and int(wanted) > 0 else float("inf")

    def send(self, **fields: str) -> None:
        """KEY=VALUE lines in one datagram; dropped when nobody listens or the buffer is full."""
        if self._socket is None:
            return
        lines = "\n".join(f"{key}={value}" for key, value in fields.items())
        with contextlib.suppress(OSError):  # the manager is busy or gone; its own timeout speaks then
            self._socket.sendto(lines.encode(), self._address)

    def store(self, name: str, fd: int) -> None:
        """Keep `fd` over our death, however we die, for the next start (FDSTORE), in place of what is stored
        by that name."""
        self.drop(name)
        if self._socket is not None:
            message = f"FDSTORE=1\nFDNAME={name}".encode()
            with contextlib.suppress(OSError):
                rights = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", [fd]))]
                self._socket.sendmsg([message], rights, 0, self._address)

    def drop(self, name: str) -> None:
        """Let go of what is stored by that name."""
        self.send(FDSTOREREMOVE="1", FDNAME=name)

    def extend(self, seconds: float) -> None:
        """The start, or the end, that is under way may take so much longer (EXTEND_TIMEOUT_USEC)."""
        self.send(EXTEND_TIMEOUT_USEC=f"{seconds * 1e6:.0f}")

    def close(self) -> None:
        """Say no more."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def alive(self, now: float) -> None:
        """WATCHDOG=1 when it is due. Called after a tick that finished every stage, from nowhere else.

        The first such tick is what READY=1 means: files valid, sockets listening, loop ticking.
        """
        if not self._ready:
            self._ready = True
            self.send(READY="1")
        if now >= self._next:
            self._next = now + self.watchdog
            if self.watchdog != float("inf"):
                self.send(WATCHDOG="1")

    def status(self, text: str, now: float) -> None:
        """STATUS= for people; sent when it changed, at most once a second.

        Made one line: a client's words may be in it, and a further line would be an order to the manager.
        """
        if text != self._status and now >= self._status_next:
            self._status = text
            self._status_next = now + STATUS
            self.send(STATUS=" ".join(text.split()))
