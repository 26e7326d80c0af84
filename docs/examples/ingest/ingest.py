"""Example of an HTTP endpoint for `twindctl stream`: keeps each message once, as lines of JSON and images.

    python docs/examples/ingest/ingest.py --out DIR

Standard library only. It is bounded in size, in connections and in time, but has no password and no
encryption. So it listens to this machine alone unless --listen names another address. --fail, --refuse and
--slow make it misbehave, to try that nothing is lost. It prints a line of JSON at the start, and one with its
counts at the end.
"""

import argparse
import fcntl
import gzip
import json
import os
import random
import re
import signal
import socket
import sys
import threading
import time
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from ipaddress import ip_address
from pathlib import Path
from types import TracebackType
from typing import Any

LONGEST = 64 << 20  # bytes of one message, also unpacked
PATIENCE = 15.0  # s that a connection may be silent
MOST = 64  # connections at once
KEY = re.compile(r"[A-Za-z0-9._-]{1,100}")
LINES = "messages.ndjson"
STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@dataclass(frozen=True, slots=True)
class ListenAddress:
    """Where to listen. `local`: this machine alone can reach it."""

    host: str
    port: int
    local: bool


def address(text: str) -> ListenAddress:
    """Parse 127.0.0.1:8000, [::1]:8000 or localhost:8000. Raises ValueError."""
    host, _, port = text.rpartition(":")
    host = "127.0.0.1" if host == "localhost" else host.removeprefix("[").removesuffix("]")
    try:
        found = ip_address(host)
        number = int(port)
    except ValueError:
        raise ValueError("write it as 127.0.0.1:8000 or [::1]:8000") from None
    if not 0 <= number <= 65535:
        raise ValueError("a port is at most 65535")
    return ListenAddress(str(found), number, found.is_loopback)


@dataclass(slots=True)
class IngestFaults:
    """Deliberate faults: shares of the messages, seconds before each answer."""

    fail: float = 0.0
    refuse: float = 0.0
    slow: float = 0.0
    seed: int = 0

    def draw(self, key: str, attempt: int) -> str:
        """Draw the fault of one attempt: "", or busy, unavailable, deaf, cut, silent, rubbish, refuse."""
        rng = random.Random(f"{self.seed} {key}")  # of one message always the same
        if rng.random() < self.refuse:
            return "refuse"
        rng = random.Random(f"{self.seed} {key} {attempt}")
        if rng.random() >= self.fail:
            return ""
        return rng.choice(("busy", "unavailable", "deaf", "cut", "silent", "rubbish"))


class IngestStore:
    """A folder with a line for each message: its key, when it came, its headers, and its body or its file."""

    def __init__(self, folder: Path) -> None:
        """Continue the folder; a last line that a crash cut off is removed. Raises OSError."""
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._lock = threading.Lock()
        self._file = os.open(folder / LINES, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
        fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # two would keep a message twice
        self._keys: set[str] = set()
        self.messages = 0
        self.samples = 0
        self.duplicates = 0
        self.failed = 0
        whole = 0
        with (folder / LINES).open("rb") as file:
            for line in file:
                if not line.endswith(b"\n"):
                    break
                whole += len(line)
                self._keys.add(json.loads(line)["key"])
        os.ftruncate(self._file, whole)

    def __enter__(self) -> "IngestStore":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.close(self._file)

    def keep(self, key: str, headers: Mapping[str, str], body: bytes) -> bool:
        """Keep a message once for each key; False: it is here already. No later crash loses it."""
        line: dict[str, Any] = {"key": key, "received": round(time.time(), 6), **headers}
        kind = headers.get("content-type", "")
        count = 0
        if kind.startswith("application/json"):
            line["body"] = json.loads(body)
            count = len(line["body"].get("samples", ())) if isinstance(line["body"], dict) else 0
        elif kind.startswith("application/x-ndjson"):
            line["lines"] = [json.loads(each) for each in body.splitlines()]
            count = max(0, len(line["lines"]) - 1)
        else:
            line["file"] = f"{key}{'.jpg' if kind.startswith('image/jpeg') else '.bin'}"
        with self._lock:
            if key in self._keys:
                self.duplicates += 1
                return False
            if "file" in line:
                (self._folder / line["file"]).write_bytes(body)
            data = memoryview(json.dumps(line, separators=(",", ":")).encode() + b"\n")
            while data:
                data = data[os.write(self._file, data) :]
            self._keys.add(key)
            self.messages += 1
            self.samples += count
        return True

    def counts(self) -> dict[str, int]:
        """Return the counts of this run: messages, samples, duplicates, failed."""
        return {
            "messages": self.messages,
            "samples": self.samples,
            "duplicates": self.duplicates,
            "failed": self.failed,
        }


class IngestServer:
    """Server with threads of its own from `start` to `stop`."""

    def __init__(self, where: ListenAddress, store: IngestStore, faults: IngestFaults) -> None:
        """Raises OSError."""
        places = threading.BoundedSemaphore(MOST)
        attempts: dict[str, int] = {}

        class Bounded(ThreadingHTTPServer):
            daemon_threads = True
            block_on_close = False
            request_queue_size = MOST
            address_family = socket.AF_INET6 if ":" in where.host else socket.AF_INET

            def process_request(self, request: Any, client_address: Any) -> None:
                if places.acquire(blocking=False):
                    super().process_request(request, client_address)
                else:
                    self.shutdown_request(request)

            def process_request_thread(self, request: Any, client_address: Any) -> None:
                try:
                    super().process_request_thread(request, client_address)
                finally:
                    places.release()

            def handle_error(self, request: Any, client_address: Any) -> None:
                """Ignore a client that hangs up in the middle: it is no error of the server."""

        class Handler(_IngestHandler):
            pass

        Handler.store = store
        Handler.faults = faults
        Handler.attempts = attempts
        self._server = Bounded((where.host, where.port), Handler)
        host, port = self._server.server_address[:2]
        self.url = f"http://{f'[{host!s}]' if ':' in str(host) else host!s}:{port}/ingest"
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True)

    def start(self) -> None:
        """Serve."""
        self._thread.start()

    def stop(self) -> None:
        """Accept no more connections."""
        self._server.shutdown()
        self._server.server_close()


class _IngestHandler(BaseHTTPRequestHandler):
    """Handler of one connection: POST to any path, with an Idempotency-Key."""

    store: IngestStore
    faults: IngestFaults
    attempts: dict[str, int]
    protocol_version = "HTTP/1.1"
    timeout = PATIENCE
    server_version = "twind-ingest"
    sys_version = ""

    def do_POST(self) -> None:
        """Keep the message, then answer."""
        length = self.headers.get("Content-Length", "")
        if not (length.isascii() and length.isdigit() and int(length) <= LONGEST):
            self.close_connection = True
            self._send_reply(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"a Content-Length of at most {LONGEST}")
            return
        body = self.rfile.read(int(length))
        key = self.headers.get("Idempotency-Key", "")
        if len(body) < int(length) or not KEY.fullmatch(key):
            self._send_reply(HTTPStatus.BAD_REQUEST, "an Idempotency-Key of 1 to 100 of A-Z a-z 0-9 . _ -")
            return
        attempt = self.attempts[key] = self.attempts.get(key, 0) + 1
        wrong = self.faults.draw(key, attempt)
        time.sleep(self.faults.slow)
        if wrong:
            self.store.failed += 1
        if wrong in ("", "cut", "silent"):  # it is kept, though the answer never comes
            self._keep(key, body, answered=not wrong)
        if wrong:
            self._misbehave(wrong)

    def _keep(self, key: str, body: bytes, *, answered: bool) -> None:
        headers = {
            name.lower(): value
            for name, value in self.headers.items()
            if name.lower().startswith(("content-type", "twind-"))
        }
        try:
            new = self.store.keep(key, headers, self._unpacked(body))
        except (ValueError, OSError, EOFError, zlib.error) as error:
            self._send_reply(HTTPStatus.UNPROCESSABLE_ENTITY, f"not what its headers say: {error}")
            return
        self.attempts.pop(key, None)
        if answered:
            self._send_reply(HTTPStatus.CREATED if new else HTTPStatus.OK, "kept" if new else "here already")

    def _unpacked(self, body: bytes) -> bytes:
        if self.headers.get("Content-Encoding") != "gzip":
            return body
        unpacking = zlib.decompressobj(wbits=31)
        found = unpacking.decompress(body, LONGEST)
        if not unpacking.eof:
            raise gzip.BadGzipFile("cut off, or too large")
        return found

    def _misbehave(self, how: str) -> None:
        if how == "refuse":
            self._send_reply(HTTPStatus.UNPROCESSABLE_ENTITY, "refused on purpose")
        elif how == "busy":
            self._send_reply(HTTPStatus.TOO_MANY_REQUESTS, "too many on purpose", {"Retry-After": "1"})
        elif how == "unavailable":
            self._send_reply(HTTPStatus.SERVICE_UNAVAILABLE, "not now on purpose")
        elif how == "rubbish":
            self.wfile.write(b"\x00\xff no HTTP at all\r\n\r\n")
            self.close_connection = True
        else:  # deaf, cut, silent: no answer, soon or late
            time.sleep(1.0 if how == "silent" else 0.0)
            self.close_connection = True

    def _send_reply(self, status: HTTPStatus, text: str, headers: Mapping[str, str] | None = None) -> None:
        body = text.encode() + b"\n"
        self.send_response(status)
        for name, value in {
            "Content-Type": "text/plain",
            "Content-Length": str(len(body)),
            **(headers or {}),
        }.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *given: Any) -> None:
        """Log nothing: the counts are enough."""


def parse(words: list[str]) -> argparse.Namespace:
    """Parse the command line. Ends the process with 2 where it is wrong."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add(
        "--listen",
        type=address,
        default="127.0.0.1:8000",
        metavar="ADDRESS:PORT",
        help="port 0: any free one",
    )
    add("--out", type=Path, default=Path("ingest"), metavar="DIR", help="folder of the messages")
    add(
        "--fail",
        type=share,
        default=0.0,
        metavar="SHARE",
        help="of the messages: refused, cut off, not answered",
    )
    add(
        "--refuse",
        type=share,
        default=0.0,
        metavar="SHARE",
        help="of the messages: 422, so they are dead letters",
    )
    add("--slow", type=float, default=0.0, metavar="S", help="delay of each answer")
    add("--seed", type=int, default=0, help="of what fails")
    return parser.parse_args(words)


def share(text: str) -> float:
    """Parse a number from 0 to 1. Raises ValueError."""
    value = float(text)
    if not 0.0 <= value <= 1.0:
        raise ValueError
    return value


def main(words: list[str]) -> int:
    """Serve until SIGINT, SIGTERM or SIGHUP."""
    options = parse(words)
    stop = threading.Event()
    for each in STOPS:
        signal.signal(each, lambda *_: stop.set())
    faults = IngestFaults(options.fail, options.refuse, options.slow, options.seed)
    try:
        store = IngestStore(options.out)
        server = IngestServer(options.listen, store, faults)
    except OSError as error:
        print(f"ingest: {options.out}, {options.listen}: {error.strerror or error}", file=sys.stderr)
        return 1
    with store:
        server.start()
        print(json.dumps({"url": server.url, "out": str(options.out)}), flush=True)
        if not options.listen.local:
            print(f"ingest: all who reach {options.listen.host} can write here", file=sys.stderr, flush=True)
        stop.wait()
        server.stop()
    print(json.dumps(store.counts()))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
