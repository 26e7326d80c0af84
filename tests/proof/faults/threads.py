"""Work of a client beside its calls: it receives events and renews its lease."""

from __future__ import annotations

import time
from contextlib import suppress
from threading import Thread
from typing import Any

from tests.support.processes import Daemon
from twind.client import Client, ClientError


class Watcher(Thread):
    """All events that the daemon tells, with its time."""

    def __init__(self, running: Daemon) -> None:
        super().__init__(daemon=True)
        self._client = running.client()
        self.events: list[dict[str, Any]] = []
        self.start()

    def run(self) -> None:
        with suppress(ClientError, OSError):
            for news in self._client.stream("Monitor", topics=["events"]):
                self.events.append(news["event"])


class Keeper(Thread):
    """Renews the lease of a client, as a client that lives does."""

    def __init__(self, client: Client) -> None:
        super().__init__(daemon=True)
        self._client = client
        self._going = True
        self.start()

    def run(self) -> None:
        while self._going:
            with suppress(ClientError, OSError):
                self._client.call("RenewLease")
            time.sleep(0.3)

    def end(self) -> None:
        """And waits for its last call."""
        self._going = False
        if self.is_alive():
            self.join(2.0)
