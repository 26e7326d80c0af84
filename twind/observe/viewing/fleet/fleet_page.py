"""The page of several robots: a window that stops all, and for each a folder with its words and its stops."""

import threading
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from twind.observe.viewing.fleet.robot_registry import RegisteredRobot, RobotRegistry
from twind.observe.viewing.stop_threads import StopAction, StopOutcome, Tell, stop_buttons, stop_window


class Broadcast:
    """Action on many robots. `errands` returns the errands of the robots known at the time of a request, by
    name."""

    def __init__(self, name: str, errands: Callable[[], Mapping[str, StopAction]]) -> None:
        self._name = name
        self._errands = errands

    def ask(self, tell: Tell) -> None:
        """Start all errands. Each failure is reported at once; the count of successes follows after the last
        answer."""
        errands = self._errands()
        if not errands:
            tell(StopOutcome(False, f"{self._name}: no robot was asked", "no robot was found yet"))
        count = _ReplyCount(self._name, frozenset(errands), tell)
        for name, errand in errands.items():
            errand.ask(partial(count.answered, name))


class _ReplyCount:
    """Count of the robots that have answered one button press."""

    def __init__(self, name: str, asked: frozenset[str], tell: Tell) -> None:
        self._name = name
        self._asked = asked
        self._tell = tell
        self._lock = threading.Lock()
        self._open = set(asked)
        self._failed = set[str]()

    def answered(self, robot: str, outcome: StopOutcome) -> None:
        """Process the outcome of one robot; runs in the thread of that robot's errand."""
        with self._lock:
            self._open.discard(robot)
            if not outcome.done:
                self._failed.add(robot)
            last = not self._open
        if not outcome.done:
            self._tell(StopOutcome(False, f"{robot}: {outcome.title}", outcome.text))
        if last:
            self._tell(self._sum())

    def _sum(self) -> StopOutcome:
        done = len(self._asked) - len(self._failed)
        title = f"{self._name}: {done} of {len(self._asked)} robots"
        if self._failed:
            return StopOutcome(False, title, f"not {', '.join(sorted(self._failed))}")
        return StopOutcome(True, title, "all have answered")


ALL = "all robots"  # no name of a robot: they have no spaces


class FleetPage:
    """HTML of several robots, sent where it differs."""

    def __init__(self, server: Any, company: RobotRegistry) -> None:
        self._gui = server.gui
        self._gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        estop = Broadcast("e-stop", lambda: {each.name: each.stops.estop for each in company.members})
        stop = Broadcast("stop", lambda: {each.name: each.stops.stop for each in company.members})
        stop_window(self._gui, estop, stop, ALL)
        self._sum = self._gui.add_html("")
        self._words: dict[str, Any] = {}
        self._said: dict[str | None, str] = {}
        self._gui.main_panel.dock_right()

    def add(self, member: RegisteredRobot) -> None:
        """A folder more."""
        with self._gui.add_folder(member.name):
            self._words[member.name] = self._gui.add_html("")
            stop_buttons(self._gui, member.stops.estop, member.stops.stop, member.name, member.name)

    def set_html(self, words: str, of: str | None = None) -> None:
        """HTML of one robot; None: of all."""
        if words != self._said.get(of):
            self._said[of] = words
            (self._sum if of is None else self._words[of]).content = words
