"""One HTTP endpoint and the connection to it that is kept. Blocks; another thread may end that by `abort`."""

import contextlib
import http.client
import socket
import ssl
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from urllib.parse import SplitResult, urlsplit

from twind.exceptions import OperationFailed

TIMEOUT = 10.0  # s without a byte
READ = 1 << 16  # bytes of an answer's body; a longer one ends the connection
SHOWN = 160  # characters of an answer that are kept as a reason
TOO_LATE = "no answer in time"


@dataclass(frozen=True, slots=True)
class HttpReply:
    """Reply of the endpoint."""

    status: int
    retry_after: str | None
    summary: str  # `422 Unprocessable Entity: no such robot`


def parsed(url: str) -> SplitResult:
    """The URL's parts. Raises ValueError for what is no http or https URL of a host."""
    found = urlsplit(url)
    if found.scheme not in ("http", "https") or not found.hostname:
        raise ValueError("write it as http://HOST:PORT/PATH or https://…")
    if found.username is not None or found.fragment:
        raise ValueError("no user and no fragment in it; a token goes into --token-file")
    _ = found.port  # ValueError where it is no number
    return found


def shown(url: str) -> str:
    """The URL for people: what stands behind ? may be a secret."""
    return url.partition("?")[0]


class HttpEndpoint:
    """`headers` go with every message; `token` is asked at every connection, for it may change."""

    def __init__(
        self,
        url: str,
        headers: Mapping[str, str],
        token: Callable[[], str] | None = None,
        timeout: float = TIMEOUT,
    ) -> None:
        """Raises ValueError for a URL that is none."""
        where = parsed(url)
        kind = http.client.HTTPSConnection if where.scheme == "https" else http.client.HTTPConnection
        assert where.hostname is not None
        self._connection = kind(where.hostname, where.port, timeout=timeout)
        self._path = (where.path or "/") + (f"?{where.query}" if where.query else "")
        self._headers = dict(headers)
        self._token = token
        self._sent_headers: dict[str, str] = {}
        self._aborted = False

    def post(self, body: bytes, headers: Mapping[str, str]) -> HttpReply:
        """Send it, and wait for the answer. Raises OperationFailed.

        A connection that was kept may have been closed meanwhile: then once more on a new one. The message
        has a key, so it does no harm where it had arrived.
        """
        self._aborted = False
        if self._connection.sock is not None:
            with contextlib.suppress(ConnectionError):
                return self._tried(body, headers)
        return self._tried(body, headers)

    def _tried(self, body: bytes, headers: Mapping[str, str]) -> HttpReply:
        """Raises OperationFailed, but ConnectionError for a kept connection that was closed meanwhile."""
        kept = self._connection.sock is not None
        try:
            answer = self._post(body, headers)
        except (OSError, http.client.HTTPException, ValueError) as error:
            self.close()
            if kept and not self._aborted and isinstance(error, ConnectionError):
                raise
            raise OperationFailed(TOO_LATE if self._aborted else _explain_error(error)) from None
        if self._aborted:  # an answer that is cut off in its head looks like a whole one
            self.close()
            raise OperationFailed(TOO_LATE)
        return answer

    def _post(self, body: bytes, headers: Mapping[str, str]) -> HttpReply:
        if self._connection.sock is None:
            self._sent_headers = dict(self._headers)
            if self._token is not None:
                self._sent_headers["Authorization"] = f"Bearer {self._token()}"
            self._connection.connect()
        self._connection.request("POST", self._path, body, {**self._sent_headers, **headers})
        answer = self._connection.getresponse()
        text = answer.read(READ)
        if not answer.isclosed() or answer.status in (401, 403):
            self.close()  # too long, or not permitted: the next connection reads the token again
        first = text[:SHOWN].decode(errors="replace").strip().partition("\n")[0]
        summary = f"{answer.status} {answer.reason}" + (
            f": {first}" if first and answer.status >= 300 else ""
        )
        return HttpReply(answer.status, answer.getheader("Retry-After"), summary)

    def abort(self) -> None:
        """End a wait in `post`, which then fails. From another thread."""
        self._aborted = True
        sock = self._connection.sock
        if sock is not None:
            with contextlib.suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Hang up; the next message connects anew."""
        self._connection.close()


def _explain_error(error: Exception) -> str:
    if isinstance(error, TimeoutError):
        return TOO_LATE
    if isinstance(error, http.client.RemoteDisconnected):
        return "it hung up without an answer"
    if isinstance(error, http.client.HTTPException):
        return f"what it answers is no HTTP ({type(error).__name__}: {str(error)[:SHOWN]})"
    if isinstance(error, ssl.SSLError):
        return f"TLS: {error.reason or error}"
    if isinstance(error, PermissionError):
        return f"{error.strerror}: the service may send to this machine alone; IPAddressAllow= of its unit"
    if isinstance(error, OSError):
        return error.strerror or str(error)
    return str(error)[:SHOWN]
