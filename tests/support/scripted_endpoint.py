"""An HTTP endpoint that answers its first requests by a script."""

import socket
import ssl
import threading
import time
from collections.abc import Callable
from contextlib import suppress

OK = b"HTTP/1.1 200 OK\r\nContent-Length: 0\r\n\r\n"
Behaviour = Callable[[socket.socket], bool]  # what it does with a request that was read; True: it goes on


def says(data: bytes) -> Behaviour:
    def behave(client: socket.socket) -> bool:
        client.sendall(data)
        return True

    return behave


class Odd:
    """An endpoint that does with its first requests what the script says, and takes all that come later."""

    def __init__(self, *script: Behaviour, context: ssl.SSLContext | None = None) -> None:
        self._script = list(script)
        self.seen: list[tuple[str, bytes, float]] = []  # key, body, when, of every request
        self._listener = socket.create_server(("127.0.0.1", 0))
        host = "http://127.0.0.1" if context is None else "https://localhost"
        self.url = f"{host}:{self._listener.getsockname()[1]}/in?secret=1"
        self._context = context
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                client, _ = self._listener.accept()
                threading.Thread(target=self._serve, args=(client,), daemon=True).start()

    def _serve(self, client: socket.socket) -> None:
        if self._context is not None:
            try:
                client = self._context.wrap_socket(client, server_side=True)
            except OSError:
                client.close()
                return
        with client, suppress(OSError), client.makefile("rb") as file:
            while line := file.readline():
                assert line.startswith(b"POST /in?secret=1 HTTP/1.1")
                fields = {}
                while (field := file.readline().strip()) and b":" in field:
                    name, _, value = field.decode().partition(":")
                    fields[name.lower()] = value.strip()
                body = file.read(int(fields["content-length"]))
                self.seen.append((fields["idempotency-key"], body, time.monotonic()))
                behave = self._script.pop(0) if self._script else says(OK)
                if not behave(client):
                    return

    def close(self) -> None:
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)  # else whoever waits in `accept` goes on listening
        self._listener.close()
