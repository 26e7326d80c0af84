"""The page of several robots: a window that stops all, and for each a folder with its words and its stops."""

from typing import Any

from twind.observe.viewing.fleet.broadcast import Broadcast
from twind.observe.viewing.fleet.robot_registry import RegisteredRobot, RobotRegistry
from twind.observe.viewing.stop_buttons import stop_buttons, stop_window

ALL = "all robots"  # no name of a robot: they have no spaces


class FleetPage:
    """What changes is HTML, sent where it differs. The last of `said` is the sum of all."""

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
