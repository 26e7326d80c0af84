"""Monitor of all robots, local and remote, which fills the roster. Imports Zenoh when a network is joined."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from twind.bridge.fleet.client_sessions import SharedSession, joining
from twind.bridge.fleet.fleet_roster import FleetRoster
from twind.bridge.fleet.local_daemons import LocalDaemonPoller
from twind.bridge.zenoh.zenoh_session import NetworkConfig, close_session, open_now, open_session
from twind.client.errors import ClientError
from twind.command_line.verb import UsageError

if TYPE_CHECKING:
    import zenoh

    from twind.bridge.fleet.remote_robots import RemoteRobotPoller

PERIOD = 1.0  # s between two questions
FINDING = 0.3  # s in which present robots have been found


class FleetMonitor:
    """Monitor of the fleet, from `once` or `begin` to `close`.

    `way`: connection to remote robots, once it exists.

    `trouble`: why there is none.
    """

    def __init__(self, roster: FleetRoster, place: NetworkConfig, only: str | None = None) -> None:
        """Make the monitor; `only`: of this machine the daemon in this folder alone."""
        self.roster = roster
        self.trouble = ""
        self.way: SharedSession | None = None
        self._place = place
        self._local = LocalDaemonPoller(roster, only)
        self._remote: RemoteRobotPoller | None = None
        self._stop = threading.Event()
        self._threads: list[threading.Thread] = []

    def once(self, patience: float, tell: Callable[[str], None]) -> None:
        """Query all robots once; return when all have answered, after `patience` s at the latest.

        `tell`: receives the robots left out.
        """
        deadline = time.monotonic() + patience
        self._local.ask()
        try:
            self._enter(open_now(self._place, joining(self._place)), tell)
        except (ClientError, UsageError) as error:
            self.trouble = str(error)
        if self._remote is not None:
            self._remote.ask()
            self._stop.wait(FINDING)  # robots are found by tokens: until they arrive, none is unknown
        self._local.wait(deadline - time.monotonic())
        while self.roster.has_unknown_robots() and time.monotonic() < deadline:
            time.sleep(0.01)

    def begin(self, tell: Callable[[str], None]) -> None:
        """Query all robots repeatedly. `tell`: receives an unreachable network, and the robots left out."""
        for what in (lambda: self._join(tell), self._ask):
            thread = threading.Thread(target=what, daemon=True)
            self._threads.append(thread)
            thread.start()

    def close(self) -> None:
        """Leave the network. May be called twice."""
        self._stop.set()
        for thread in self._threads:
            thread.join(2.0 * PERIOD)
        if self.way is not None:
            with contextlib.suppress(Exception):  # whatever is wrong with it, it is over
                close_session(self.way.session)
        self.way = self._remote = None

    def _join(self, tell: Callable[[str], None]) -> None:
        try:
            session = open_session(self._place, self._stop, self._make_error_callback(tell))
        except (ClientError, UsageError) as error:
            self.trouble = str(error)
            tell(self.trouble)
            return
        if session is not None:
            self._enter(session, tell)

    def _make_error_callback(self, tell: Callable[[str], None]) -> Callable[[str], None]:
        def on_error(why: str) -> None:
            self.trouble = why
            tell(why)

        return on_error

    def _enter(self, session: zenoh.Session, tell: Callable[[str], None]) -> None:
        from twind.bridge.fleet.remote_robots import RemoteRobotPoller

        self.way = SharedSession(session, str(self._place))
        self.trouble = ""
        self._remote = RemoteRobotPoller(self.roster, session, tell)

    def _ask(self) -> None:
        while not self._stop.is_set():
            self._local.ask()
            if self._remote is not None:
                self._remote.ask()
            self._stop.wait(PERIOD)
