"""Client of a remote robot: `twindctl --remote ROBOT VERB`. Imports Zenoh when it is used."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

from twind.bridge.zenoh.zenoh_session import (
    VARIABLE,
    NetworkConfig,
    close_session,
    here,
    missing,
    open_now,
    parse_config,
)
from twind.client import Client, ClientError, NoDaemon
from twind.client.connection import TIMEOUT
from twind.command_line.verb import UsageError

if TYPE_CHECKING:
    import zenoh

# s that joining a network may take; one of this machine
JOINING = 3.0
BESIDE = 0.3
NAME_IT = f"the network is named by --remote ROBOT@tcp/HOST:PORT or {VARIABLE}"


def joining(place: NetworkConfig) -> float:
    """Return the s that joining the network may take; less where every router would be on this machine."""
    beside = place.connect and all(here(each) for each in place.connect)
    return BESIDE if beside else JOINING


@dataclass(frozen=True, slots=True)
class PrivateSession:
    """A session for one line alone."""

    place: NetworkConfig

    @property
    def where(self) -> str:
        """The network, as it was named."""
        return str(self.place)

    def open_session(self, patience: float) -> zenoh.Session:
        """Join the network. Raises NoDaemon."""
        try:
            return open_now(self.place, min(patience, joining(self.place)))
        except ClientError as error:
            raise NoDaemon(f"{error}; {NAME_IT}") from None

    def release_session(self, session: zenoh.Session) -> None:
        """Close the session."""
        close_session(session)


@dataclass(frozen=True, slots=True)
class SharedSession:
    """A session that many lines use, each with a queue of its own; its opener closes it."""

    session: zenoh.Session
    where: str

    def open_session(self, patience: float) -> zenoh.Session:
        """Return the shared session."""
        return self.session

    def release_session(self, session: zenoh.Session) -> None:
        """Do nothing: other lines use the session."""


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
