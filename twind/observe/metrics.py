"""Serve the daemon's figures to Prometheus as OpenMetrics text.

A client of observe.sock, on 127.0.0.1 or a Unix socket. A scrape is answered from the last message of the
daemon, so it never waits. After 3 s without a message, `twind_up` is 0 and no other figure is served. An
address that other machines can reach is refused, since there is no password and no encryption. For remote
scrapes, use a proxy that has both.
"""

import argparse
import contextlib
import os
import socket
import stat
from typing import Any

from twind.command_line.verb import DONE, Rejected, UsageError

group = "connect"

LISTEN = "127.0.0.1:9797"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--listen", metavar="ADDRESS:PORT", help=f"a loopback address (default {LISTEN}; port 0: any free)"
    )
    where.add_argument("--unix", metavar="PATH", help="a Unix socket instead, mode 0660")
    where.add_argument("--once", action="store_true", help="print what is known now, and end")
    parser.add_argument(
        "--text",
        action="store_true",
        help="with --once: the older text format, which node_exporter's textfile collector reads",
    )


def run(options: argparse.Namespace) -> int:
    """Exit code 0; with --once 3, after `twind_up 0`, if there is no daemon or it sends too little."""
    if options.text and not options.once:
        raise UsageError("--text needs --once: a scraper asks for the format that it wants")
    if "" in (options.unix, options.listen):  # perhaps an unset variable: no socket that all users may read
        raise UsageError("--unix and --listen: empty; name a path, or an address and port")
    from twind.observe.measuring import metrics_server  # 0.1 s of imports that `twindctl --help` need not pay

    if options.once:
        return metrics_server.once(options)
    listener = unix(options.unix) if options.unix else loopback(options.listen or LISTEN)
    try:
        metrics_server.serve(options, listener)
    finally:
        listener.close()
        if options.unix:
            with contextlib.suppress(FileNotFoundError):
                os.unlink(options.unix)
    return DONE


def loopback(place: str) -> socket.socket:
    """A listener there. Raises UsageError for what is not this machine's own address, Rejected if taken."""
    import ipaddress

    host, _, port = place.rpartition(":")
    host = "127.0.0.1" if host == "localhost" else host.removeprefix("[").removesuffix("]")
    try:
        address = ipaddress.ip_address(host)
        number = int(port)
    except ValueError:
        raise UsageError(f"--listen {place}: write it as {LISTEN} or [::1]:9797") from None
    if not address.is_loopback or not 0 <= number <= 65535:
        raise UsageError(
            f"--listen {place}: only an address of this machine alone, such as {LISTEN}, and a port to 65535:"
            " all who reach it can read. For remote access use a proxy with a password, or ssh -L"
        )
    listener = socket.socket(socket.AF_INET if address.version == 4 else socket.AF_INET6)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    return _bound(listener, (str(address), number), place)


def unix(path: str) -> socket.socket:
    """Listener on a Unix socket, mode 0660; a socket without a server is replaced. Raises Rejected."""
    try:
        _make_way(path)
    except OSError as error:
        raise Rejected(f"--unix {path}: {error.strerror or error}; name another path") from None
    before = os.umask(0o117)  # not by a chmod afterwards: no other process gets in between
    try:
        return _bound(socket.socket(socket.AF_UNIX), path, path)
    finally:
        os.umask(before)


def _make_way(path: str) -> None:
    """Remove a socket without a server. Raises Rejected, and OSError without the permission."""
    with contextlib.suppress(FileNotFoundError), socket.socket(socket.AF_UNIX) as asking:
        if not stat.S_ISSOCK(os.stat(path).st_mode):
            raise Rejected(f"--unix {path}: something else than a socket is there; name another path")
        try:
            asking.connect(path)
        except ConnectionRefusedError:
            os.unlink(path)
        else:
            raise Rejected(
                f"--unix {path}: a program serves it already; end that first, or name another path"
            )


def _bound(listener: socket.socket, address: Any, place: str) -> socket.socket:
    try:
        listener.bind(address)
    except OSError as error:
        listener.close()
        raise Rejected(f"{place}: {error.strerror}; name another with --listen or --unix") from None
    return listener
