"""Sessions with a Zenoh network, at configured endpoints only.

Neither scouting nor gossip: nothing is multicast and no other node is found by chance. The default stays on
this machine: a router at LOCAL, no listening. Keys of a configuration file are the
engine's own (zenoh.io: `DEFAULT_CONFIG.json5`); what it leaves out is as here.
"""

from __future__ import annotations

import argparse
import json
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from ipaddress import ip_address
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twind.client import ClientError
from twind.command_line.extras import how_to_add
from twind.command_line.verb import UsageError

if TYPE_CHECKING:
    import zenoh

LOCAL = "tcp/127.0.0.1:7447"  # where a router of this machine listens
VARIABLE = "TWIND_ZENOH"  # endpoints by commas, or the path of a configuration file
FILES = (".json5", ".json", ".yaml", ".yml")
LARGEST = 5 << 20  # bytes of one message, a trajectory's and a little; a larger one must not fill the memory
PARTING = 1.0  # s that threads of the engine may take to end
TRY = 1.0  # s for one attempt to connect, and between two
SEALED = ("tls", "quic", "unixsock-stream")  # links that no host on the path can read
CALLBACK = "pyo3-closure"  # in the name of a thread that the engine's Python binding made


def missing() -> str:
    """The reason and remedy where the package of Zenoh is not installed."""
    return f"the package eclipse-zenoh is not installed: {how_to_add('zenoh')}"


@dataclass(frozen=True, slots=True)
class NetworkConfig:
    """Configuration of a network: endpoints as `tcp/HOST:PORT`, a file with all other settings."""

    connect: tuple[str, ...] = ()
    listen: tuple[str, ...] = ()
    file: Path | None = None

    def __str__(self) -> str:
        parts = [*self.connect, *(f"listening at {each}" for each in self.listen)]
        return ", ".join([*parts, *([str(self.file)] if self.file else [])])


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add `--connect`, `--listen`, `--zenoh-config`."""
    parser.add_argument(
        "--connect",
        action="append",
        default=[],
        metavar="ENDPOINT",
        help=f"a router, tcp/HOST:PORT or tls/HOST:PORT; may be repeated (default: {VARIABLE}, else {LOCAL})",
    )
    parser.add_argument(
        "--listen",
        action="append",
        default=[],
        metavar="ENDPOINT",
        help="accept connections here; may be repeated",
    )
    parser.add_argument(
        "--zenoh-config",
        type=Path,
        metavar="FILE",
        help="configuration of Zenoh: certificates, access control",
    )


def place(options: argparse.Namespace, environ: Mapping[str, str]) -> NetworkConfig:
    """Return the network of the options, else of the variable, else the router of this machine."""
    given = NetworkConfig(tuple(options.connect), tuple(options.listen), options.zenoh_config)
    return parse_config(environ.get(VARIABLE, "")) if given == NetworkConfig() else given


def parse_config(text: str) -> NetworkConfig:
    """Parse the value of VARIABLE; empty: LOCAL."""
    if text.endswith(FILES):
        return NetworkConfig(file=Path(text))
    endpoints = tuple(each.strip() for each in text.split(",") if each.strip())
    return NetworkConfig(connect=endpoints or (LOCAL,))


def readable(place: NetworkConfig) -> list[str]:
    """Return the endpoints, also of its file, whose traffic hosts on the path can read and forge.

    Raises ClientError: the configuration is wrong.
    """
    made = make_configuration(place, TRY)
    named = [each for key in ("connect", "listen") for each in _endpoints(_get(made, f"{key}/endpoints"))]
    return [each for each in named if each.partition("/")[0] not in SEALED and not here(each)]


def open_session(
    place: NetworkConfig, stop: threading.Event, tell: Callable[[str], None]
) -> zenoh.Session | None:
    """Join the network as soon as it answers; return None if `stop` was set before.

    `tell` receives one line if it does not answer. Raises ClientError: the configuration is wrong.
    """
    configuration = make_configuration(place, TRY)
    reported = False
    while not stop.is_set():
        try:
            return _open(configuration)
        except ClientError as error:
            if not reported:
                tell(f"{place}: {error}; trying on")
            reported = True
        stop.wait(TRY)  # a refused endpoint fails at once: without a pause this would fill a core
    return None


def open_now(place: NetworkConfig, patience: float) -> zenoh.Session:
    """Join the network within `patience` s. Raises ClientError."""
    try:
        return _open(make_configuration(place, patience))
    except ClientError as error:
        raise ClientError(f"{place}: {error}") from None


def close_session(session: zenoh.Session) -> None:
    """Close it, and wait until its callbacks are over, `PARTING` s at most.

    Each has a thread, a daemon where a daemon declared it. One that comes back from compiled code while the
    interpreter ends takes the process down with it: SIGABRT, "exception not rethrown" (eclipse-zenoh 1.10.2).
    """
    session.close()
    deadline = time.monotonic() + PARTING
    for thread in threading.enumerate():
        if thread.daemon and CALLBACK in thread.name:
            thread.join(max(0.0, deadline - time.monotonic()))


def _open(configuration: zenoh.Config) -> zenoh.Session:
    try:
        session: zenoh.Session = _engine().open(configuration)
    except Exception as error:  # noqa: BLE001  whatever the engine raises is reported in its words
        raise ClientError(_words(error)) from None
    return session


def make_configuration(place: NetworkConfig, patience: float) -> zenoh.Config:
    """Raises ClientError."""
    engine = _engine()
    try:
        made: zenoh.Config = engine.Config() if place.file is None else engine.Config.from_file(place.file)
    except Exception as error:  # noqa: BLE001  as above
        raise ClientError(f"{place.file}: {_words(error)}") from None
    if place.connect:
        _put(made, "connect/endpoints", list(place.connect))
    if place.listen:
        _put(made, "listen/endpoints", list(place.listen))
    usual: dict[str, object] = {
        "listen/endpoints": [],  # by default a peer listens on every interface
        "mode": "peer" if place.listen else "client",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/link/rx/max_message_size": LARGEST,
        "connect/timeout_ms": int(patience * 1e3),
        "connect/exit_on_failure": not place.listen,  # a listening session need not wait for others
    }
    untouched = engine.Config()
    for key, value in usual.items():
        if _get(made, key) == _get(untouched, key):
            _put(made, key, value)
    return made


def _get(configuration: zenoh.Config, key: str) -> Any:
    return json.loads(configuration.get_json(key))


def _endpoints(configured: Any) -> list[str]:
    """Return the endpoints of all modes."""
    listed = (
        configured
        if isinstance(configured, list)
        else [each for some in configured.values() for each in some]
    )
    return [str(each) for each in dict.fromkeys(listed)]


def _put(configuration: zenoh.Config, key: str, value: Any) -> None:
    try:
        configuration.insert_json5(key, json.dumps(value))
    except Exception as error:  # noqa: BLE001  as above
        raise ClientError(_words(error)) from None


def _engine() -> Any:
    """Import the engine. Raises UsageError: it is not installed."""
    try:
        import zenoh
    except ImportError:
        raise UsageError(missing()) from None
    return zenoh


def _words(error: Exception) -> str:
    """Return the text of an engine's error without the place in its source."""
    return str(error).partition(" at /")[0].rstrip(" .!") or type(error).__name__


def here(endpoint: str) -> bool:
    """Return whether a host is this machine."""
    host = endpoint.partition("/")[2].partition("?")[0].partition("#")[0].rpartition(":")[0].strip("[]")
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False
