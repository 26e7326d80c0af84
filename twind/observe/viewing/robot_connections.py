"""Connections to a robot: by the sockets of a daemon here, or by any other client with the same calls.

This module knows no transport but the sockets.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

from twind.client import Client, ClientError, NoDaemon


class ClientConnection(Protocol):
    """Methods of a `Client` that the viewer needs. Each raises ClientError."""

    def call(self, method: str, **parameters: Any) -> Any:
        """Return the parameters of the answer."""

    def stream(self, method: str, **parameters: Any) -> Iterator[Any]:
        """Yield the parameters of every answer."""

    def close(self) -> None:
        """Close the connection."""


Way = Callable[[float], ClientConnection]  # that waits so long for an answer, s; raises ClientError


@dataclass(frozen=True, slots=True)
class RobotConnections:
    """Ways to connect to one robot. Several threads use them at once, each on connections of its own.

    `reading`: each also takes an e-stop; where one fails the next is tried. `commanding`: also takes
    `Cancel`.
    """

    reading: tuple[Way, ...]
    commanding: Way


def local(place: str | None) -> RobotConnections:
    """Return the ways to the daemon whose sockets are in the folder `place`; None: the usual folder."""
    observing, commanding = (partial(_connected, place, name) for name in ("observe", "control"))
    return RobotConnections((observing, commanding), commanding)


def observer(ways: RobotConnections, patience: float) -> ClientConnection:
    """A connection that reads, by the first way that leads there. Raises the ClientError of the last."""
    failure: ClientError = NoDaemon("no way leads to it")
    for way in ways.reading:
        try:
            return way(patience)
        except ClientError as error:
            failure = error
    raise failure


def _connected(place: str | None, name: str, patience: float) -> ClientConnection:
    client = Client(place, name=name, timeout=patience)
    client.connect()
    return client
