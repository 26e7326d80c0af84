"""Client of a remote robot: `twindctl --remote ROBOT VERB`. Imports Zenoh when it is used."""

import os

from twind.bridge.fleet.client_sessions import PrivateSession, SharedSession
from twind.bridge.zenoh.zenoh_session import VARIABLE, missing, parse_config
from twind.client import Client
from twind.client.connection import TIMEOUT
from twind.command_line.verb import UsageError


def client(robot: str, way: PrivateSession | SharedSession, timeout: float = TIMEOUT) -> Client:
    """A connection to `robot`, made at its first call. Raises UsageError: no name of a robot."""
    try:
        from twind.bridge.fleet.zenoh_line import ZenohClientLine
    except ImportError:
        raise UsageError(missing()) from None
    try:
        return Client(line=ZenohClientLine(robot, way), timeout=timeout)
    except ValueError as error:
        raise UsageError(str(error)) from None


def remote(text: str) -> Client:
    """Return the client of `ROBOT` or `ROBOT@tcp/HOST:PORT`. Raises UsageError, also without Zenoh."""
    robot, at, place = text.partition("@")
    if at and not place:
        raise UsageError(f"--remote {text}: expected ROBOT or ROBOT@tcp/HOST:PORT")
    return client(robot, PrivateSession(parse_config(place or os.environ.get(VARIABLE, ""))))
