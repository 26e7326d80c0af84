"""Zenoh sessions of clients of remote robots: one for a client alone, or one that many share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from twind.bridge.zenoh.zenoh_session import VARIABLE, NetworkConfig, close_session, here, open_now
from twind.client import ClientError, NoDaemon

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
