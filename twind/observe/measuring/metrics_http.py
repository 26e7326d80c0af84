"""HTTP for scrapers: one request per connection, bounded in size and time, answered by a WSGI application.

A client that hangs, reads slowly or sends invalid data occupies one of `MOST` places for at most `PATIENCE`.
A Host that is no name of this machine is refused: otherwise a web page whose name was rebound to 127.0.0.1
could read the answer. Independent of metrics.
"""

import asyncio
import re
from collections.abc import Callable, Iterable
from http import HTTPStatus
from typing import Any

PATIENCE = 5.0  # s from the connection to the last byte of its answer
LONGEST = 8192  # bytes of a request
MOST = 256  # connections at once
NAMES = ("127.0.0.1", "[::1]", "localhost")  # of this machine, for itself

Environ = dict[str, str]
Application = Callable[[Environ, Any], Iterable[bytes]]


class MetricsHttpHandler:
    """Connection handler for `asyncio.start_server` and `start_unix_server` with limit=LONGEST."""

    def __init__(self, application: Application) -> None:
        self._application = application
        self._open = 0

    async def __call__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Answer it, or cut it off."""
        self._open += 1
        try:
            if self._open <= MOST:
                async with asyncio.timeout(PATIENCE):
                    writer.write(await self._answer(reader))
                    writer.close()
                    await writer.wait_closed()  # until all of it is written
        except (OSError, TimeoutError, asyncio.IncompleteReadError):
            pass  # it hung up, or hangs
        finally:
            self._open -= 1
            writer.transport.abort()

    async def _answer(self, reader: asyncio.StreamReader) -> bytes:
        try:
            head = await reader.readuntil(b"\r\n\r\n")
        except asyncio.LimitOverrunError:
            return plain(HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE)
        request = environ(head)
        return plain(request) if isinstance(request, HTTPStatus) else answered(self._application, request)


def environ(head: bytes) -> Environ | HTTPStatus:
    """WSGI environment of a request (up to its empty line), or the status of the refusal."""
    line, *fields = head.decode("latin-1").split("\r\n")
    words = line.split(" ")
    if len(words) != 3 or not words[0].isalpha() or not words[1].startswith("/"):
        return HTTPStatus.BAD_REQUEST
    if not words[2].startswith("HTTP/1."):
        return HTTPStatus.HTTP_VERSION_NOT_SUPPORTED
    path, _, query = words[1].partition("?")
    found = {"REQUEST_METHOD": words[0].upper(), "PATH_INFO": path, "QUERY_STRING": query}
    for each in fields:
        name, _, value = each.partition(":")
        key = f"HTTP_{name.strip().upper().replace('-', '_')}"
        found[key] = f"{found[key]},{value.strip()}" if key in found else value.strip()
    if re.sub(r":[0-9]*$", "", found.get("HTTP_HOST", NAMES[0])).lower() not in NAMES:
        return HTTPStatus.MISDIRECTED_REQUEST
    return found


def answered(application: Application, asked: Environ) -> bytes:
    """Whole answer of the application, or a refusal for another path or fields that it cannot take."""
    if asked["PATH_INFO"] == "/":
        return plain(HTTPStatus.OK, "twindctl metrics: see /metrics")
    if asked["PATH_INFO"] != "/metrics":
        return plain(HTTPStatus.NOT_FOUND)
    begun: list[tuple[str, list[tuple[str, str]]]] = []
    try:
        body = b"".join(application(asked, lambda status, fields: begun.append((status, fields))))
    except (ValueError, TypeError):  # prometheus_client 0.26 compares a version that is no number
        return plain(HTTPStatus.BAD_REQUEST)
    return _bytes(*begun[0], body)


def plain(status: HTTPStatus, text: str = "") -> bytes:
    """An answer of one line."""
    body = f"{text or status.phrase}\n".encode()
    return _bytes(f"{status.value} {status.phrase}", [("Content-Type", "text/plain; charset=utf-8")], body)


def _bytes(status: str, fields: list[tuple[str, str]], body: bytes) -> bytes:
    lines = [f"HTTP/1.1 {status}", *(f"{name}: {value}" for name, value in fields)]
    lines += [f"Content-Length: {len(body)}", "Connection: close", "", ""]
    return "\r\n".join(lines).encode("latin-1") + body
