"""Entry of the front process: `python -m twind.front --link FD --briefing FD [--control FD] [--observe FD]`.

Started by the loop, with inherited descriptors, in a session of its own. It ends at end-of-file on the
link and at nothing else: the loop handles SIGTERM and SIGINT.
"""

import argparse
import asyncio
import os
import signal
import socket
import sys
from collections.abc import Mapping
from pathlib import Path

import msgspec

from twind.briefing import Briefing
from twind.front.client_session import ClientSession
from twind.front.daemon_log import DaemonLog, LogWriter
from twind.front.flight_dumper import RecorderHandover
from twind.front.front_server import FrontServer
from twind.front.systemd_journal import SOCKET
from twind.front.time_slice import lengthen
from twind.listening_sockets import Listener
from twind.sealed_memfd import unseal
from twind.standard_streams import at_journal


def main() -> int:
    """Serve until the loop is gone."""
    parser = argparse.ArgumentParser(prog="twind.front", description="Started by twind; not for people.")
    parser.add_argument("--parent", type=int, help="process id of the loop, for diagnosis in /proc")
    parser.add_argument("--link", type=int, required=True, help="SOCK_SEQPACKET socket to the loop")
    parser.add_argument("--briefing", type=int, required=True, help="sealed memfd")
    parser.add_argument("--control", type=int, help="listening socket for operators")
    parser.add_argument("--observe", type=int, help="listening socket for observers")
    for name in ("control", "observe"):
        parser.add_argument(
            f"--{name}-file", metavar="LABEL", help="identity of its file; without it unchecked"
        )
    parser.add_argument("--flight", type=int, help="memfd of the flight recorder")
    parser.add_argument("--wreck", type=int, help="the same of a daemon before this one that is gone")
    parser.add_argument("--folder", type=Path, default=Path(), help="where flight recorders are written to")
    arguments = parser.parse_args()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, signal.SIG_IGN)
    for name, fd in vars(arguments).items():
        if isinstance(fd, int) and name != "parent":
            os.set_inheritable(fd, False)
    lengthen()  # before any thread
    briefing = msgspec.msgpack.decode(unseal(arguments.briefing), type=Briefing)
    os.close(arguments.briefing)
    stderr = sys.stderr.fileno()
    journal = at_journal(stderr)
    log = DaemonLog(LogWriter(stderr, SOCKET if journal else None), briefing.log_level, journal=journal)
    listeners = {
        "control": (arguments.control, arguments.control_file),
        "observe": (arguments.observe, arguments.observe_file),
    }
    try:
        recorded = RecorderHandover(arguments.folder, arguments.flight, arguments.wreck)
        asyncio.run(_serve(socket.socket(fileno=arguments.link), briefing, log, listeners, recorded))
    finally:
        log.close()
    return 0


async def _serve(
    link: socket.socket,
    briefing: Briefing,
    log: DaemonLog,
    listeners: Mapping[str, tuple[int | None, str | None]],
    recorded: RecorderHandover,
) -> None:
    front = FrontServer(link, briefing, log, ClientSession, recorded)
    front.loop.set_exception_handler(front.unexpected)
    for name, (fd, label) in listeners.items():
        if fd is not None:
            front.listening.add(name, _listener(fd, label), checked=label is not None)
    await front.ended.wait()
    front.listening.close()  # at once: threads that load a model are waited for
    front.part()
    front.reloads.close()
    front.gap.close()
    await front.flights.end()


def _listener(fd: int, label: str | None) -> Listener:
    return Listener(socket.socket(fileno=fd)) if label is None else Listener.inherited(fd, label)


if __name__ == "__main__":
    sys.exit(main())
