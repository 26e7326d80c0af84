"""The viewer's web server: on 127.0.0.1 alone, and only for users that have its address.

Every web page in the user's browser, and every user of this machine, can connect to a port of 127.0.0.1. So
the address has a secret in its path, which goes with every request. Host and Origin must be those of this
page (against a foreign page, and a rebound name), and the page may not contact any other host. viser has no
setting for that: its arguments for websockets pass through here, and a viser that does otherwise is refused.
The page gets a script and a style of its own here, and a WebSocket that viser does not see.
"""

import contextlib
import hmac
import io
import logging
import os
import secrets
from collections.abc import Awaitable, Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from twind.exceptions import OperationFailed
from twind.observe.viewing.page_backlog import shorten_backlog
from twind.observe.viewing.page_channel import PATH, PageChannel

HOST = "127.0.0.1"
PORT = 8099  # where it begins to look for one that is free
NAMES = frozenset({"127.0.0.1", "localhost"})  # of this machine; the port may be another one, by `ssh -L`
# s between two pings of a browser, and until one that does not answer is gone
HEAD_END = b"</head>"
PING = 2.0
GONE = 5.0
STRANGERS = 32  # connections that have not shown the secret, such as of another user: no more descriptors
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval' blob:; worker-src blob:; "
    "style-src 'unsafe-inline'; img-src data: blob:; font-src data:; connect-src 'self' data: blob: "
    "ws://{host}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)

GET = b"GET "
NO_GET = b"HTTP/1.1 403 Forbidden\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"

Handler = Callable[[Any], Awaitable[None]]


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
        if not hmac.compare_digest("".join(first).encode(errors="surrogateescape"), self.secret.encode()):
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
            connection.count_no_more()
            headers = request.headers.copy()
            headers.pop("Accept-Encoding", None)  # the page is changed below
            answer = inner(connection, replace(request, path=self.inside(request.path), headers=headers))
            return answer if answer is None else _closed(_with_own_parts(answer), request.headers["Host"])

        return process

    def route(self, viewer: Handler, own: Handler) -> Handler:
        """Handler of WebSockets: `own` for the page's script, `viewer` for all others."""

        async def handle(connection: Any) -> None:
            path = self.inside(connection.request.path).partition("?")[0]
            await (own if path == PATH else viewer)(connection)

        return handle


def _with_own_parts(response: Any) -> Any:
    """Add the viewer's script and style to a page of HTML; anything else is unchanged."""
    folder = Path(__file__).parent
    head, end, rest = response.body.rpartition(HEAD_END)
    if end:
        style = (folder / "viewer_page.css").read_bytes()
        script = (folder / "viewer_page.js").read_bytes()
        own = b"<style>%b</style><script>%b</script>" % (style, script)
        response.body = head + own + end + rest
        del response.headers["Content-Length"]  # an assignment adds a second one
        response.headers["Content-Length"] = str(len(response.body))
    return response


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
    channel: PageChannel = field(default_factory=PageChannel)


@contextlib.contextmanager
def opened(port: int | None, title: str) -> Iterator[ViewerSite]:
    """A server until the end of the block; without `port` the first that is free. Raises DoorError."""
    import viser
    from viser import _messages

    door = ViewerAccess()
    channel = PageChannel()
    os.environ.pop("_VISER_PORT_OVERRIDE", None)  # would win over the port
    with (
        contextlib.redirect_stdout(io.StringIO()),
        _guarded(door, channel) as guarded,
    ):  # it prints an address without
        server = viser.ViserServer(host=HOST, port=PORT if port is None else port, label=title, verbose=False)
    try:
        if not guarded or server.get_host() != HOST:
            raise OperationFailed(f"viser {viser.__version__} cannot be guarded: install one from 1.1 on")
        if port and server.get_port() != port:
            raise OperationFailed(f"--port {port} is taken: leave --port out, and a free one is found")
        for message in (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect):
            server._websock_server.unregister_handler(message)  # one message would publish it on the internet
        shorten_backlog(server._websock_server._broadcast_buffer)
        yield ViewerSite(server, f"http://{HOST}:{server.get_port()}/{door.secret}/", channel)
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()


def _answering(connection: Any) -> Any:
    """Return a class of connections that answers 403 to what is no GET; websockets closes it unanswered.

    Of `STRANGERS` and one more, the oldest is broken: the stop buttons need descriptors.
    """
    strangers: dict[Any, None] = {}  # the oldest first

    class ViewerConnection(connection):  # type: ignore[misc]  # a class of an optional package
        """Connection of one browser."""

        begun = False

        def connection_made(self, transport: Any) -> None:
            """Begin with a new peer."""
            super().connection_made(transport)
            strangers[self] = None
            if len(strangers) > STRANGERS:
                oldest = next(iter(strangers))
                oldest.count_no_more()
                oldest.transport.abort()

        def connection_lost(self, error: Exception | None) -> None:
            """End with the peer."""
            self.count_no_more()
            super().connection_lost(error)

        def count_no_more(self) -> None:
            """Count it no more: it has shown the secret, or is over."""
            strangers.pop(self, None)

        def data_received(self, data: bytes) -> None:
            """Take bytes of the peer."""
            if not self.begun and not data.startswith(GET[: len(data)]):
                self.transport.write(NO_GET)
                self.transport.close()
            elif not self.transport.is_closing():
                super().data_received(data)
            self.begun = True

    return ViewerConnection


def _log() -> logging.Logger:
    """Return a log without failed handshakes: any program of this machine can cause them."""
    log = logging.Logger("twind viewer", logging.WARNING)
    log.addFilter(lambda record: record.msg != "opening handshake failed")
    return log


@contextlib.contextmanager
def _guarded(door: ViewerAccess, channel: PageChannel) -> Iterator[list[bool]]:
    """While viser starts, what it serves goes through the door; one entry for each time it did."""
    from websockets.asyncio import server as websockets

    before = websockets.serve
    served = []

    def serve(handler: Any, host: str, port: int, *, process_request: Any, **options: Any) -> Any:
        served.append(True)
        return before(
            door.route(handler, channel.serve),
            host,
            port,
            process_request=door.guard(process_request),
            create_connection=_answering(websockets.ServerConnection),
            logger=_log(),
            ping_interval=PING,
            ping_timeout=GONE,
            **options,
        )

    setattr(websockets, "serve", serve)  # noqa: B010  mypy has it as a class
    try:
        yield served
    finally:
        setattr(websockets, "serve", before)  # noqa: B010
