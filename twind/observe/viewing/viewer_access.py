"""The viewer's web server: on 127.0.0.1 alone, and only for users that have its address.

Every web page in the user's browser, and every user of this machine, can connect to a port of 127.0.0.1. So
the address has a secret in its path, which goes with every request. Host and Origin must be those of this
page (against a foreign page, and a rebound name), and the page may not contact any other host. viser has no
setting for that: its arguments for websockets pass through here, and a viser that does otherwise is refused.
"""

import contextlib
import hmac
import io
import os
import secrets
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any
from urllib.parse import urlsplit

from twind.exceptions import OperationFailed

HOST = "127.0.0.1"
PORT = 8099  # where it begins to look for one that is free
NAMES = frozenset({"127.0.0.1", "localhost"})  # of this machine; the port may be another one, by `ssh -L`
# s between two pings of a browser, and until one that does not answer is gone
PING = 2.0
GONE = 5.0
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval' blob:; worker-src blob:; "
    "style-src 'unsafe-inline'; img-src data: blob:; font-src data:; connect-src 'self' data: blob: "
    "ws://{host}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


@dataclass(frozen=True)
class ViewerAccess:
    """Access check of the viewer's web server. `secret`: the first part of every path."""

    secret: str = field(default_factory=lambda: secrets.token_urlsafe(24))

    def refusal(self, path: str, headers: Any) -> str | None:
        """Why this request gets nothing; None: it may pass. `headers`: of websockets, by name without
        case."""
        hosts = headers.get_all("Host")
        origins = headers.get_all("Origin")
        if len(hosts) != 1 or _name(hosts[0]) not in NAMES:
            return "Host is not this machine"
        if origins and origins != [f"http://{hosts[0]}"]:
            return "Origin is another page"
        upgrade = headers.get_all("Upgrade")
        if upgrade and (upgrade != ["websocket"] or not origins):
            return "a WebSocket without the Origin of this page"
        first = path.partition("?")[0].split("/")[1:2]
        if not hmac.compare_digest("".join(first).encode(), self.secret.encode()):
            return "the address lacks its secret: use the one that was printed"
        return None

    def inside(self, path: str) -> str:
        """The path as viser knows it."""
        return "/" + path.partition(self.secret)[2].lstrip("/")

    def guard(self, inner: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
        """`process_request` of websockets, before that of viser."""

        def process(connection: Any, request: Any) -> Any:
            why = self.refusal(request.path, request.headers)
            if why is not None:
                return _closed(connection.respond(403, f"{why}\n"), "none")
            answer = inner(connection, replace(request, path=self.inside(request.path)))
            return answer if answer is None else _closed(answer, request.headers["Host"])

        return process


def _name(host: str) -> str | None:
    try:
        return urlsplit(f"//{host}").hostname
    except ValueError:
        return None


def _closed(response: Any, host: str) -> Any:
    """Set the headers of a response: no content from elsewhere, no framing, no caching, no referrer."""
    response.headers["Content-Security-Policy"] = POLICY.format(host=host)
    response.headers["Referrer-Policy"] = "no-referrer"
    response.headers["X-Content-Type-Options"] = "nosniff"
    response.headers["Cache-Control"] = "no-store"
    return response


@dataclass(frozen=True)
class ViewerSite:
    """A viser server behind its door."""

    server: Any  # viser.ViserServer
    url: str


@contextlib.contextmanager
def opened(port: int | None, title: str) -> Iterator[ViewerSite]:
    """A server until the end of the block; without `port` the first that is free. Raises DoorError."""
    import viser
    from viser import _messages

    door = ViewerAccess()
    os.environ.pop("_VISER_PORT_OVERRIDE", None)  # would win over the port
    with contextlib.redirect_stdout(io.StringIO()), _guarded(door) as guarded:  # it prints an address without
        server = viser.ViserServer(host=HOST, port=PORT if port is None else port, label=title, verbose=False)
    try:
        if not guarded or server.get_host() != HOST:
            raise OperationFailed(f"viser {viser.__version__} cannot be guarded: install one from 1.1 on")
        if port and server.get_port() != port:
            raise OperationFailed(f"--port {port} is taken: leave --port out, and a free one is found")
        for message in (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect):
            server._websock_server.unregister_handler(message)  # one message would publish it on the internet
        yield ViewerSite(server, f"http://{HOST}:{server.get_port()}/{door.secret}/")
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()


@contextlib.contextmanager
def _guarded(door: ViewerAccess) -> Iterator[list[bool]]:
    """While viser starts, what it serves goes through the door; one entry for each time it did."""
    from websockets.asyncio import server as websockets

    before = websockets.serve
    served = []

    def serve(handler: Any, host: str, port: int, *, process_request: Any, **options: Any) -> Any:
        served.append(True)
        return before(
            handler,
            host,
            port,
            process_request=door.guard(process_request),
            ping_interval=PING,
            ping_timeout=GONE,
            **options,
        )

    setattr(websockets, "serve", serve)  # noqa: B010  mypy has it as a class
    try:
        yield served
    finally:
        setattr(websockets, "serve", before)  # noqa: B010
