"""Protocol of a verb of `twindctl`; its connections to the daemon and its output. Standard library only."""

import argparse
import contextlib
import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, TextIO

from twind.client import CallError, Client, ClientError, first_open
from twind.exceptions import TwindError

REMOTES = "twind.remotes"  # entry points: functions that make a Client from the value of --remote
GROUPS = ("drive", "see", "set up", "record", "learn", "connect")  # headings of `twindctl --help`
# exit codes
DONE = 0
REFUSED = 1
USAGE = 2
NO_DAEMON = 3
INTERRUPTED = 130
EXIT_CODES = {
    DONE: "done",
    REFUSED: "refused or failed",
    USAGE: "wrong usage",
    NO_DAEMON: "no daemon",
    INTERRUPTED: "interrupted by Ctrl-C; 0 where that is the usual end, as of record and view",
}


class Verb(Protocol):
    """A module or an object; the entry-point group `twind.verbs` names more of them.

    `group` is one of GROUPS. The docstring of a module is its help: the first line is the line of the verb in
    `twindctl --help`. A verb whose calls all work through `--remote` sets `supports_remote = True`. Its help
    omits the common options of `unused_options`, such as `("--socket",)` of a verb that asks no daemon.
    """

    group: str

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Options of the verb, beside `--socket` and `--json`."""

    def run(self, options: argparse.Namespace) -> int:
        """Run the verb. Returns the exit code. May raise ClientError and UsageError."""


@dataclass(frozen=True, slots=True)
class FunctionVerb:
    """A verb made of two functions.

    `text`: the line of the verb in `twindctl --help`, then paragraphs that only its own help shows.
    """

    group: str
    text: str
    add_arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], int]
    supports_remote: bool = False


def no_arguments(_parser: argparse.ArgumentParser) -> None:
    """Add no arguments."""


def one_call(
    method: str,
    text: Callable[[argparse.Namespace, Any], str],
    parameters: Callable[[argparse.Namespace], Mapping[str, Any]] = lambda _: {},
) -> Callable[[argparse.Namespace], int]:
    """Make the `run` of a verb that makes one call as an operator and prints the `text` of its answer."""

    def run(options: argparse.Namespace) -> int:
        with operator(options) as client:
            answer = client.call(method, **parameters(options))
        show(options, answer, text(options, answer))
        return DONE

    return run


def help_text(verb: Verb) -> str:
    """Documentation of a verb."""
    return verb.text if isinstance(verb, FunctionVerb) else (verb.__doc__ or "")


class UsageError(TwindError):
    """Error for arguments that make no sense as written: exit code 2."""


class Rejected(TwindError):
    """A file or a motion that was not accepted: exit code 1."""


def operator(options: argparse.Namespace) -> Client:
    """A connection that may command."""
    return Client(options.socket) if remote_robot(options) is None else remote_client(options)


def connected(options: argparse.Namespace, *names: str) -> Client:
    """Connect to the first of the sockets `names` that accepts. Raises the NoDaemon of the last one."""
    if remote_robot(options) is not None:
        client = remote_client(options)
        client.connect()
        return client
    return first_open(options.socket, *names)


def observer(options: argparse.Namespace) -> Client:
    """Open a connection that only reads: it takes no place of an operator."""
    return connected(options, "observe", "control")


def remote_client(options: argparse.Namespace) -> Client:
    """A connection to the robot of `--remote`, made at the first call. Raises UsageError."""
    from importlib.metadata import entry_points  # takes 20 ms, which local calls need not pay

    for point in entry_points(group=REMOTES):
        client: Client = point.load()(remote_robot(options))
        return client
    raise UsageError("--remote: no installed package reaches remote robots")


def remote_robot(options: argparse.Namespace) -> str | None:
    """The robot of `--remote`. None: a daemon of this machine."""
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

    Work that takes longer than a second must call `RenewLease`, or the daemon ends the lease.
    """
    with lease(client, take=take):
        client.call("Calibrate", on=True)
        try:
            yield
        finally:
            with contextlib.suppress(ClientError, RuntimeError):
                client.call("Calibrate", on=False)


def write_register(client: Client, *, take: bool = False, **register: Any) -> Any:
    """Call WriteRegister; for an EEPROM register in a `calibrating` of its own. Raises ClientError."""
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


def show(options: argparse.Namespace, data: Any, text: str, file: TextIO | None = None) -> None:
    """Print the result: `data` as one line of JSON, or `text` without its control characters.

    `file`: None, standard output. A reader that is gone changes neither what the verb does nor its exit code.
    """
    output = json.dumps(data, ensure_ascii=False) if options.json else harmless_lines(text)
    try:
        print(output, flush=True, file=file)
    except BrokenPipeError:
        if file is not None:
            raise
        discard_output()


def complain(
    options: argparse.Namespace, error: Exception, complete: Callable[[str], str] = lambda text: text
) -> None:
    """Print an error: as JSON on standard output, or as text on standard error.

    As text too where standard output takes nothing: its disk is full, or its reader gone. `complete` adds the
    options of this call to the commands in the text.
    """
    if options.json and _is_printed(error):
        return
    for line in complete(str(error)).splitlines():
        print(f"twindctl: {harmless(line)}", file=sys.stderr)


def _is_printed(error: Exception) -> bool:
    """Print an error as JSON; False: standard output does not take it."""
    name: str = type(error).__name__
    parameters: Mapping[str, Any] = {"message": str(error)}
    if isinstance(error, CallError):
        name = error.error
        parameters = error.parameters
    try:
        print(json.dumps({"error": name, "parameters": parameters}, ensure_ascii=False), flush=True)
    except OSError:
        discard_output()
        return False
    return True


def discard_output() -> None:
    """Let standard output go nowhere: what waits to be written would fail again when the process ends."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)
