"""The robots of one page: found again and again, each listened to in a thread of its own."""

import threading
import time
import traceback
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from twind.client import ClientError
from twind.observe.viewing.daemon_messages import messages
from twind.observe.viewing.robot_connections import RobotConnections
from twind.observe.viewing.robot_viewer import take
from twind.observe.viewing.stop_threads import StopThreads
from twind.observe.viewing.viewer_state import News, ViewerState

RATE = 10.0  # Hz of states: pictures a second, for each robot
TOPICS = ("state", "status", "events")
BY = "twindctl fleet --view"
MOST = 64  # robots on one page
LOOKED = 1.0  # s between two looks who is there
PARTING = 1.0  # s that threads may take to end

Whose = tuple[str, str]  # a robot's name and place, unique together
Found = Callable[
    [], Mapping[Whose, RobotConnections]
]  # who is there; may take seconds, may raise ClientError


class RegisteredRobot:
    """One robot, for as long as the page is there, whether or not anything comes from it."""

    def __init__(self, name: str, ways: RobotConnections, ended: threading.Event) -> None:
        self.name = name
        self.known = ViewerState()
        self.stops = StopThreads(ways, by=BY)
        self.listening = _started(f"news of {name}", take, self.known, _news(ways, ended))


def _news(ways: RobotConnections, ended: threading.Event) -> Iterable[News]:
    return messages(ways, ended, topics=TOPICS, rate=RATE)


class RobotRegistry:
    """All robots ever found, in that order. Each keeps the connections and the name that it was given first.

    A later robot of the same name has its place appended to the name.
    """

    def __init__(self, found: Found) -> None:
        self._found = found
        self._ended = threading.Event()
        self._names: dict[Whose, str] = {}
        self._members: tuple[RegisteredRobot, ...] = ()
        self.problem = ""  # why no other robot can be found
        self._looking = _started("who is there", self._look)

    @property
    def members(self) -> tuple[RegisteredRobot, ...]:
        """Robots found up to now; later ones are added, none is removed."""
        return self._members

    def close(self) -> None:
        """Listen no more. Returns when the threads have ended, after `PARTING` s at the latest.

        A thread that is in compiled code while the interpreter ends takes the process down with it (SIGABRT).
        """
        self._ended.set()
        deadline = time.monotonic() + PARTING
        for thread in (self._looking, *(each.listening for each in self._members)):
            thread.join(max(0.0, deadline - time.monotonic()))

    def _look(self) -> None:
        while not self._ended.is_set():
            try:
                self.problem = self._take(self._found())
            except ClientError as error:
                self.problem = str(error)
            except Exception as error:  # noqa: BLE001  those who are known stay, and their buttons
                problem = f"{type(error).__name__}: {error}"
                if problem != self.problem:
                    traceback.print_exc()
                self.problem = problem
            self._ended.wait(LOOKED)

    def _take(self, found: Mapping[Whose, RobotConnections]) -> str:
        """Add the robots of `found` that are new; return why some are left out, or "".

        At most `MOST` are added, since each has a thread, and the page a folder for it.
        """
        for whose, ways in found.items():
            if whose not in self._names:
                if len(self._names) >= MOST:
                    return f"there are more than {MOST}: the others are not on this page"
                name, where = whose
                self._names[whose] = f"{name} ({where})" if name in self._names.values() else name
                self._members = (*self._members, RegisteredRobot(self._names[whose], ways, self._ended))
        return ""


def _started(name: str, do: Callable[..., None], *arguments: Any) -> threading.Thread:
    thread = threading.Thread(target=do, args=arguments, name=name, daemon=True)
    thread.start()
    return thread
