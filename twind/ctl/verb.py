"""What a verb of `twindctl` is, and how verbs talk to the daemon and to people. Standard library only."""

import argparse
import contextlib
import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol

from twind.client import CallError, Client, ClientError, first_open
from twind.exceptions import TwindError

REMOTES = "twind.remotes"  # entry points: of the value of --remote a Client
# exit codes
DONE = 0
REFUSED = 1
USAGE = 2
NO_DAEMON = 3


class Verb(Protocol):
    """A module or an object; the entry-point group `twind.verbs` names more of them.

    One that also works with `--remote`, as all it asks of a robot goes that way, says `from_afar = True`.
    """

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Options of the verb, beside `--socket` and `--json`."""

    def run(self, options: argparse.Namespace) -> int:
        """Do it; the exit code. May raise ClientError and UsageError."""


@dataclass(frozen=True, slots=True)
class FunctionVerb:
    """A verb made of two functions."""

    add_arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], int]
    from_afar: bool = False


class UsageError(TwindError):
    """Error for arguments that make no sense as written: exit code 2."""


class Rejected(TwindError):
    """A file or a motion that was not accepted: exit code 1."""


def operator(options: argparse.Namespace) -> Client:
    """A connection that may command."""
    return Client(options.socket) if elsewhere(options) is None else from_afar(options)


def connected(options: argparse.Namespace, *names: str) -> Client:
    """Connect to the first of the sockets `names` that accepts. Raises the NoDaemon of the last one."""
    if elsewhere(options) is not None:
        client = from_afar(options)
        client.connect()
        return client
    return first_open(options.socket, *names)


def observer(options: argparse.Namespace) -> Client:
    """Open a connection that only reads: it takes no place of an operator."""
    return connected(options, "observe", "control")


def from_afar(options: argparse.Namespace) -> Client:
    """A connection to the robot of `--remote`, made at the first call. Raises UsageError."""
    from importlib.metadata import entry_points  # 20 ms that nobody else need pay

    for point in entry_points(group=REMOTES):
        client: Client = point.load()(elsewhere(options))
        return client
    raise UsageError("--remote: nothing that is installed here reaches robots elsewhere")


def elsewhere(options: argparse.Namespace) -> str | None:
    """The robot of `--remote`; None: a daemon of this machine is meant."""
    return getattr(options, "remote", None)


@contextlib.contextmanager
def lease(client: Client, *, take: bool = False) -> Iterator[None]:
    """Hold the lease; give it back at the end if the connection still lives."""
    client.call("AcquireLease", take=take or None)
    try:
        yield
    finally:
        if client.connected:
            with contextlib.suppress(ClientError, RuntimeError):
                client.call("ReleaseLease")


@contextlib.contextmanager
def calibrating(client: Client, *, take: bool = False) -> Iterator[None]:
    """Hold the lease and the state `calibrating`; both are given back at the end.

    Who takes longer than a second has to call `RenewLease`, or the daemon ends it.
    """
    with lease(client, take=take):
        client.call("Calibrate", on=True)
        try:
            yield
        finally:
            with contextlib.suppress(ClientError, RuntimeError):
                client.call("Calibrate", on=False)


def write_register(client: Client, *, take: bool = False, **register: Any) -> Any:
    """WriteRegister; of EEPROM, as the daemon says, in a `calibrating` of its own. Raises ClientError."""
    try:
        return client.call("WriteRegister", **register)
    except CallError as error:
        if error.name != "WrongState" or "calibrating" not in error.parameters.get("allowed", ()):
            raise
    with calibrating(client, take=take):
        return client.call("WriteRegister", **register)


def harmless(text: str) -> str:
    """Replace control characters, so that none reaches the terminal.

    The text comes from a file, a daemon or a client.
    """
    return text if text.isprintable() else "".join(each if each.isprintable() else "?" for each in text)


def harmless_lines(text: str) -> str:
    """Several lines, each of them harmless."""
    return "\n".join(harmless(line) for line in text.split("\n"))


def show(options: argparse.Namespace, data: Any, text: str) -> None:
    """The result: `data` as one line of JSON, or `text` for people, of which no control character is said."""
    said = json.dumps(data, ensure_ascii=False) if options.json else harmless_lines(text)
    print(said, flush=True)


def complain(options: argparse.Namespace, error: Exception) -> None:
    """An error: as JSON on standard output, or as text on standard error."""
    if not options.json:
        for line in str(error).splitlines():
            print(f"twindctl: {harmless(line)}", file=sys.stderr)
    elif isinstance(error, CallError):
        print(json.dumps({"error": error.error, "parameters": error.parameters}, ensure_ascii=False))
    else:
        print(json.dumps({"error": type(error).__name__, "parameters": {"message": str(error)}}))
