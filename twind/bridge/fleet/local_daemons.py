"""Poller of the daemons of this machine: found by their sockets, queried in parallel."""

import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from twind.bridge.fleet.fleet_roster import FleetRoster
from twind.bridge.zenoh.zenoh_keys import robot_name
from twind.client import ClientError, first_open
from twind.client.find_socket import directories

PATIENCE = 2.0  # s for an answer
NAMES = ("observe", "control")


def folders(only: str | None = None) -> list[str]:
    """Return the folders with sockets: those of a client, and the instances below them. `only`: that one."""
    if only is not None:
        return [only]
    found = [each for place in directories() for each in (place, *_below(place)) if _has_sockets(each)]
    return list(dict.fromkeys(found))


class LocalDaemonPoller:
    """Poller of local daemons: each call queries all at once. One that hangs delays no other."""

    def __init__(self, roster: FleetRoster, only: str | None = None) -> None:
        """Make the poller; `only`: the daemon in this folder and no other."""
        self._roster = roster
        self._only = only
        self._names: dict[str, str] = {}  # of robots, by folder
        self._queries: dict[str, threading.Thread] = {}

    def ask(self) -> None:
        """Query each daemon without a pending query. Returns at once."""
        for folder in dict.fromkeys([*folders(self._only), *self._names]):
            before = self._queries.get(folder)
            if before is None or not before.is_alive():
                thread = threading.Thread(target=self._ask, args=(folder,), daemon=True)
                self._queries[folder] = thread
                thread.start()

    def wait(self, seconds: float) -> None:
        """Wait until all have answered, `seconds` at most."""
        deadline = time.monotonic() + seconds
        for thread in self._queries.values():
            thread.join(max(0.0, deadline - time.monotonic()))

    def _ask(self, folder: str) -> None:
        begun = time.monotonic()
        try:
            with first_open(folder, *NAMES, timeout=PATIENCE) as client:
                answer = client.call("GetStatus", joints=True)
                now = time.monotonic()
                if folder not in self._names:
                    parameters = client.call("GetParameters")["parameters"]
                    self._names[folder] = robot_name(answer["status"], parameters)
            self._roster.update_status(self._names[folder], folder, answer, now, now - begun)
        except ClientError as error:
            if folder in self._names or not getattr(error, "absent", False):
                self._record_lost_daemon(folder, str(error))
        except (KeyError, TypeError, AttributeError) as error:
            self._record_lost_daemon(folder, f"its report cannot be decoded: {error!r}")

    def _record_lost_daemon(self, folder: str, why: str) -> None:
        """Record a lost daemon; one that never reported its name gets that of its folder, the instance's."""
        self._roster.mark_lost(self._names.get(folder) or Path(folder).name, folder, why)


def _below(place: str) -> Iterator[str]:
    try:
        with os.scandir(place) as entries:
            yield from sorted(entry.path for entry in entries if entry.is_dir())
    except OSError:
        return


def _has_sockets(folder: str) -> bool:
    return any(os.path.exists(os.path.join(folder, f"{name}.sock")) for name in NAMES)
