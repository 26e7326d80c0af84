"""`twindctl metrics` at work: a thread follows the daemon, an event loop keeps the ledger and answers."""

import argparse
import asyncio
import contextlib
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterable
from typing import Any

from prometheus_client import CollectorRegistry, generate_latest, make_wsgi_app
from prometheus_client.metrics_core import Metric
from prometheus_client.openmetrics.exposition import generate_latest as openmetrics

from twind.client import Client, ClientError
from twind.command_line.verb import DONE, NO_DAEMON, complain, harmless, observer
from twind.observe.measuring.metric_families import families
from twind.observe.measuring.metrics_http import LONGEST, MOST, MetricsHttpHandler
from twind.observe.measuring.metrics_ledger import STALE, TOPICS, Fields, MetricsLedger

AGAIN = 0.5  # s between two attempts to reach the daemon
ONCE = 2.5  # s that --once waits for all metrics: a histogram comes once a second

Tell = Callable[[Fields | None], None]


def serve(options: argparse.Namespace, listener: socket.socket) -> None:
    """Until SIGTERM or Ctrl-C."""
    asyncio.run(_serve(options, listener))


async def _serve(options: argparse.Namespace, listener: socket.socket) -> None:
    loop = asyncio.get_running_loop()
    ledger = MetricsLedger(time.time())
    stop = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    door = MetricsHttpHandler(make_wsgi_app(registry(ledger)))
    start: Any = asyncio.start_unix_server if listener.family == socket.AF_UNIX else asyncio.start_server
    server = await start(door, sock=listener, limit=LONGEST, backlog=MOST)
    print(f"metrics   {harmless(_address(listener))}", flush=True)
    threading.Thread(target=follow, args=(options.socket, _teller(loop, ledger)), daemon=True).start()
    async with server:
        await stop.wait()


def _teller(loop: asyncio.AbstractEventLoop, ledger: MetricsLedger) -> Tell:
    """Hands what the following thread hears to the loop's, which alone knows the ledger."""

    def log_message(message: Fields | None) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has ended
            if message is None:
                loop.call_soon_threadsafe(ledger.forget)
            else:
                loop.call_soon_threadsafe(ledger.take, message, time.monotonic(), time.time())

    return log_message


def follow(place: str | None, tell: Tell) -> None:
    """Pass every message of the daemon to `tell`, None when it is gone. Never returns; prints each change."""
    said = ""
    while True:
        try:
            with Client(place, name="observe", timeout=STALE) as client:
                for message in client.stream("Monitor", topics=list(TOPICS)):
                    tell(message)
                    said = _changed(said, "connected")
        except (ClientError, ValueError) as error:
            tell(None)
            said = _changed(said, str(error))
        time.sleep(AGAIN)


def _changed(status: str, now: str) -> str:
    if now != status:
        print(f"twindctl: {now}", file=sys.stderr, flush=True)
    return now


def once(options: argparse.Namespace) -> int:
    """All that can be had within a moment, printed. The exit code."""
    ledger = MetricsLedger(time.time())
    until = time.monotonic() + ONCE
    ended = DONE
    try:
        with observer(options) as client:
            client.timeout = STALE
            for message in client.stream("Monitor", topics=list(TOPICS[:3])):
                ledger.take(message, time.monotonic(), time.time())
                if ledger.is_complete or time.monotonic() > until:
                    break
    except ClientError as error:
        complain(options, error)
        ended = NO_DAEMON
    if ended == DONE and ledger.news(time.monotonic()) is None:
        complain(
            options, ClientError(f"the daemon is there, but sent too little within {ONCE:g} s; try again")
        )
        ended = NO_DAEMON
    encode = generate_latest if options.text else openmetrics
    print(encode(registry(ledger)).decode(), end="", flush=True)
    return ended


def registry(ledger: MetricsLedger) -> CollectorRegistry:
    """One of our own: with the library's the figures of this process would come along."""

    class Collector:
        def collect(self) -> Iterable[Metric]:
            return families(ledger.news(time.monotonic()))

    made = CollectorRegistry()
    made.register(Collector())
    return made


def _address(listener: socket.socket) -> str:
    """The URL, or the command that reads a Unix socket."""
    if listener.family == socket.AF_UNIX:
        return f"curl --unix-socket {listener.getsockname()} http://localhost/metrics"
    host, port = listener.getsockname()[:2]
    return f"http://{f'[{host}]' if ':' in host else host}:{port}/metrics"
