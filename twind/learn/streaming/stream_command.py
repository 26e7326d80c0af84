"""Stream the robot's state to an HTTP endpoint without loss.

A client of observe.sock. Each message is on disk before it is sent (POST, header Idempotency-Key), and
stays there until the endpoint has accepted it. An endpoint that keeps one message of each key has every
sample once. If messages are too many or too old, the oldest are dropped and counted: their numbers are
missing. docs/examples/ingest/ingest.py is an endpoint to try it with.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sqlite3
import time
from importlib.util import find_spec
from ipaddress import ip_address
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

from twind.command_line.extras import how_to_add
from twind.command_line.stop_signals import catch_stop_signals
from twind.command_line.verb import DONE, Rejected, UsageError, harmless
from twind.exceptions import OperationFailed

if TYPE_CHECKING:
    from twind.learn.streaming.http_endpoint import HttpEndpoint
    from twind.learn.streaming.spool import Spool
    from twind.learn.streaming.stream_runner import MessageSource, StreamRunner

group = "connect"

URL = "http://localhost:8000/ingest"
MB = 1 << 20
HOUR = 3600.0
FIELD = re.compile(r"([A-Za-z0-9!#$%&'*+.^_`|~-]+):[ \t]*([\x20-\x7e]*)")
OURS = frozenset(
    {"idempotency-key", "content-type", "content-encoding", "content-length", "transfer-encoding", "host"}
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `twindctl stream`."""
    parser.add_argument("--url", default=URL, help=f"where to POST (default {URL})")
    parser.add_argument(
        "--header",
        action="append",
        default=[],
        metavar="'NAME: VALUE'",
        help="header to send; may be repeated",
    )
    parser.add_argument(
        "--token-file",
        type=Path,
        metavar="FILE",
        help="sent as Authorization: Bearer ...; read at each connection",
    )
    parser.add_argument(
        "--rate",
        type=float,
        default=100.0,
        metavar="HZ",
        help="samples a second, at most the loop's (default 100)",
    )
    parser.add_argument(
        "--batch", type=int, default=32, metavar="N", help="samples of a message (default 32)"
    )
    parser.add_argument(
        "--age", type=float, default=1.0, metavar="S", help="a message is closed after so long (default 1)"
    )
    parser.add_argument("--ndjson", action="store_true", help="a line for each sample instead of one object")
    parser.add_argument("--gzip", action="store_true", help="compressed, on disk too")
    parser.add_argument(
        "--spool",
        type=Path,
        metavar="DIR",
        help="where messages wait (default: `stream` in the state folder)",
    )
    parser.add_argument(
        "--spool-mb", type=float, default=512.0, metavar="MB", help="what may wait (default 512)"
    )
    parser.add_argument(
        "--spool-age", type=float, default=72.0, metavar="HOURS", help="how long (default 72)"
    )
    parser.add_argument(
        "--camera",
        choices=["render"],
        help="pictures too, drawn of the robot as its twin has it (extra: learn)",
    )
    parser.add_argument("--camera-rate", type=float, default=1.0, metavar="HZ", help="of them (default 1)")
    parser.add_argument("--seconds", type=float, metavar="S", help="stop by itself")
    what = parser.add_mutually_exclusive_group()
    what.add_argument(
        "--dead", action="store_true", help="list the messages that the endpoint refuses, and end"
    )
    what.add_argument("--dead-again", action="store_true", help="send these messages again, then stream")


def run(options: argparse.Namespace) -> int:
    """Stream until a stop signal: 0. The spool cannot be opened: 1."""
    from twind.learn.streaming.spool import Spool, SpoolLimits

    folder = options.spool or usual_folder()
    if options.dead:
        return _list(options, folder)
    _check(options)
    endpoint = _endpoint(options)
    bounds = SpoolLimits(int(options.spool_mb * MB), options.spool_age * HOUR)
    try:
        with Spool(folder, bounds, time.monotonic(), time.time()) as spool:
            return _stream(options, spool, endpoint)
    except OperationFailed as error:
        raise Rejected(str(error)) from None
    except (OSError, sqlite3.Error) as error:
        why = getattr(error, "strerror", None) or error
        raise Rejected(f"{folder}: {why}; name another spool with --spool") from None


def _stream(options: argparse.Namespace, spool: Spool, endpoint: HttpEndpoint) -> int:
    from twind.learn.streaming.stream_runner import StreamRunner

    with catch_stop_signals() as stop:
        course = StreamRunner(options, spool, endpoint, stop)
        if spool.set_aside:
            course.tell(f"{spool.folder}: {spool.set_aside}")
        if options.token_file and _readable_by_others(options.url):
            course.tell(f"{options.url}: without https every host on the path can read the token")
        if options.dead_again:
            course.tell(f"{spool.revive()} dead letters are sent again")
        return course.run(_cameras(options, course))


def _cameras(options: argparse.Namespace, course: StreamRunner) -> list[MessageSource]:
    if options.camera is None:
        return []
    from twind.learn.streaming.picture_streamer import PictureStreamer

    return [PictureStreamer(options, course.basket, options.camera_rate, course.tell)]


def usual_folder() -> Path:
    """`stream` below this user's state folder."""
    from twind.config.daemon_settings import places

    return places(os.environ, os.geteuid()).state / "stream"


def _check(options: argparse.Namespace) -> None:
    """Raises UsageError."""
    for name in ("rate", "age", "spool_mb", "spool_age", "seconds", "camera_rate"):
        value = getattr(options, name)
        if value is not None and not (isfinite(value) and value > 0.0):
            raise UsageError(f"--{name.replace('_', '-')} {value:g}: must be above 0")
    if not 1 <= options.batch <= 10_000:
        raise UsageError(f"--batch {options.batch}: from 1 to 10000")
    if options.camera is not None and not (find_spec("PIL") and find_spec("OpenGL")):
        raise UsageError(f"--camera render draws with packages that are not installed: {how_to_add('learn')}")


def _endpoint(options: argparse.Namespace) -> HttpEndpoint:
    from twind.learn.streaming.http_endpoint import HttpEndpoint

    headers = {"User-Agent": "twind-stream"}
    for given in options.header:
        found = FIELD.fullmatch(given)
        if found is None or found[1].lower() in OURS:
            raise UsageError(
                f"--header {given!r}: write it as 'Name: value'; not one that says what a message is"
            )
        headers[found[1]] = found[2]
    token = None if options.token_file is None else lambda: _token(options.token_file)
    try:
        if token is not None:
            token()
        return HttpEndpoint(options.url, headers, token)
    except ValueError as error:
        raise UsageError(f"--url {options.url}: {error}") from None
    except OSError as error:
        raise UsageError(f"--token-file {options.token_file}: {error.strerror or error}") from None


def _token(path: Path) -> str:
    """Raises OSError."""
    text = path.read_text(errors="replace").strip()
    if not text or not text.isascii() or not text.isprintable():
        raise OSError("not one line of visible characters")
    return text


def _readable_by_others(url: str) -> bool:
    from twind.learn.streaming.http_endpoint import parsed

    where = parsed(url)
    try:
        here = where.hostname == "localhost" or ip_address(str(where.hostname)).is_loopback
    except ValueError:
        here = False
    return where.scheme == "http" and not here


def _list(options: argparse.Namespace, folder: Path) -> int:
    """Dead letters, a line each."""
    from twind.learn.streaming.spool import dead_letters

    try:
        letters = dead_letters(folder)
    except sqlite3.Error as error:
        raise Rejected(f"{folder}: no spool that can be read ({error}); name another with --spool") from None
    for each in letters:
        size = len(each.message.body)
        count = each.message.samples
        fields = ("sequence", "wall", "bytes", "samples", "reason")
        fields_of = dict(
            zip(fields, (each.sequence, round(each.wall, 3), size, count, each.reason), strict=True)
        )
        when = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(each.wall))
        line = f"{each.sequence:>8}  {when}  {size:>8} B  {count:>3} samples  {each.reason}"
        print(json.dumps(fields_of, ensure_ascii=False) if options.json else harmless(line))
    if not letters and not options.json:
        print("no dead letters")
    return DONE
