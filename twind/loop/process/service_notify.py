"""sd_notify: one datagram per message to $NOTIFY_SOCKET (sd_notify(3)); nothing without that variable.

READY does not depend on the servos: an unplugged robot must not fail the start. The status line reports it.
"""

import array
import contextlib
import os
import socket

STATUS = 1.0  # s between two status lines: a servo that comes and goes must not flood the service manager


class Notifier:
    """Sender of notices to the service manager.

    Never blocks or raises, so that a lost notice costs no tick.
    """

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
        """Send KEY=VALUE lines in one datagram; dropped without a receiver or with a full buffer."""
        if self._socket is None:
            return
        lines = "\n".join(f"{key}={value}" for key, value in fields.items())
        with contextlib.suppress(OSError):  # the manager is busy or gone; its own timeout handles that
            self._socket.sendto(lines.encode(), self._address)

    def store(self, name: str, fd: int) -> None:
        """Store `fd` with the service manager for the next start (FDSTORE), however this process ends.

        It replaces the descriptor stored by that name.
        """
        self.drop(name)
        if self._socket is not None:
            message = f"FDSTORE=1\nFDNAME={name}".encode()
            with contextlib.suppress(OSError):
                rights = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", [fd]))]
                self._socket.sendmsg([message], rights, 0, self._address)

    def drop(self, name: str) -> None:
        """Remove the descriptor stored by that name."""
        self.send(FDSTOREREMOVE="1", FDNAME=name)

    def extend(self, seconds: float) -> None:
        """Request more time for the start or end under way (EXTEND_TIMEOUT_USEC), s."""
        self.send(EXTEND_TIMEOUT_USEC=f"{seconds * 1e6:.0f}")

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def alive(self, now: float) -> None:
        """Send WATCHDOG=1 when it is due. Called only after a tick that finished every stage.

        The first such tick sends READY=1: files valid, sockets listening, loop ticking.
        """
        if not self._ready:
            self._ready = True
            self.send(READY="1")
        # Sent four times per watchdog interval: a single late tick must not end the daemon
        # (sd_watchdog_enabled(3) advises half).
        if now >= self._next:
            self._next = now + self.watchdog
            if self.watchdog != float("inf"):
                self.send(WATCHDOG="1")

    def status(self, text: str, now: float) -> None:
        """Send STATUS= for people when it changed, at most once a second.

        It is made one line: it may hold a client's text, and a further line would be a command to the
        manager.
        """
        if text != self._status and now >= self._status_next:
            self._status = text
            self._status_next = now + STATUS
            self.send(STATUS=" ".join(text.split()))
