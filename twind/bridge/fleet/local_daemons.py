"""The daemons of this machine: found by their sockets, asked one beside the other."""

import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from twind.bridge.fleet.fleet_roster import FleetRoster
from twind.bridge.uplink.robot_name import robot_name
from twind.client import ClientError, first_open
from twind.client.find_socket import directories

PATIENCE = 2.0  # s for an answer
NAMES = ("observe", "control")


def folders(only: str | None = None) -> list[str]:
    """Folders with sockets: those that a client looks at, and the instances below them. `only`: that one."""
    if only is not None:
        return [only]
    found = [each for place in directories() for each in (place, *_below(place)) if _has_sockets(each)]
    return list(dict.fromkeys(found))


class LocalDaemonPoller:
    """Asks each of them, all at once, whenever it is told to. One that hangs holds up nobody."""

    def __init__(self, roll: FleetRoster, only: str | None = None) -> None:
        """`only`: the daemon in this folder and no other."""
        self._roll = roll
        self._only = only
        self._names: dict[str, str] = {}  # of robots, by folder
        self._asked: dict[str, threading.Thread] = {}

    def ask(self) -> None:
        """Whoever is not being asked. Returns at once."""
        for folder in dict.fromkeys([*folders(self._only), *self._names]):
            before = self._asked.get(folder)
            if before is None or not before.is_alive():
                thread = threading.Thread(target=self._ask, args=(folder,), daemon=True)
                self._asked[folder] = thread
                thread.start()

    def wait(self, seconds: float) -> None:
        """Until all have answered, `seconds` at most."""
        deadline = time.monotonic() + seconds
        for thread in self._asked.values():
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
            self._roll.update_status(self._names[folder], folder, answer, now, now - begun)
        except ClientError as error:
            if folder in self._names or not getattr(error, "absent", False):
                self._record_lost_daemon(folder, str(error))
        except (KeyError, TypeError, AttributeError) as error:
            self._record_lost_daemon(folder, f"what it says cannot be understood: {error!r}")

    def _record_lost_daemon(self, folder: str, why: str) -> None:
        """One that never said its name has that of its folder, which is the instance's."""
        self._roll.mark_lost(self._names.get(folder) or Path(folder).name, folder, why)


def _below(place: str) -> Iterator[str]:
    try:
        with os.scandir(place) as entries:
            yield from sorted(entry.path for entry in entries if entry.is_dir())
    except OSError:
        return


def _has_sockets(folder: str) -> bool:
    return any(os.path.exists(os.path.join(folder, f"{name}.sock")) for name in NAMES)
