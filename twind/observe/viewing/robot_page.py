"""The page of one robot: buttons, words, plots. Nothing here waits: what a button asks for is done
elsewhere."""

import contextlib
import hmac
import secrets
import threading
from collections.abc import Callable
from typing import Any

from twind.observe.viewing import operator_lease
from twind.observe.viewing.dead_man_hold import Press
from twind.observe.viewing.jog_control import jog
from twind.observe.viewing.joint_html import joint_rows
from twind.observe.viewing.live_plots import LivePlots
from twind.observe.viewing.operator_lease import OperatorThread, Work
from twind.observe.viewing.robot_scene import AUTO, GHOSTS
from twind.observe.viewing.stop_threads import (
    ButtonPress,
    StopOutcome,
    StopThreads,
    Tell,
    teller,
)
from twind.observe.viewing.viewer_access import ViewerSite
from twind.observe.viewing.viewer_state import Message, ViewerState
from twind.robot.finding import ReasonCode
from twind.robot_client.jog_motion import JogRequest

NO_LEASE = "this tab does not hold the lease. Remedy: press `Take the lease` first"


class RobotPage:
    """The parts that do not change with the robot, and the words and plots that do."""

    def __init__(self, site: ViewerSite, known: ViewerState, stops: StopThreads | None) -> None:
        gui = site.server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        if stops is not None:
            site.channel.stops = {"estop": stops.estop, "stop": stops.stop}
        self._words = gui.add_html("")
        with gui.add_folder("alerts"):
            self._alerts = gui.add_html("")
        self._ghost = gui.add_dropdown("translucent", options=GHOSTS, initial_value=AUTO)
        gui.main_panel.dock_right()
        panel = gui.add_panel()
        with panel.add_tab("joints"):
            self._joints = gui.add_html("")
        with panel.add_tab("last 10 s"):
            self._plots = LivePlots(gui, known)
        panel.dock_left()
        panel.set_width(340)
        panel.expand()  # also on a small screen, where panels are sections of a sheet

    def set_robot(self, robot: Message, *, jogs: bool) -> None:
        """The joints of another robot; `jogs`: with buttons that move them."""
        self._joints.content = joint_rows(robot, jogs=jogs)
        self._plots.set_joints(tuple(str(joint["name"]) for joint in robot["joints"]))

    def draw(self) -> None:
        """Draw the plots with the newest values."""
        self._plots.draw()

    @property
    def ghost(self) -> str:
        """The selected translucent figures."""
        return str(self._ghost.value)

    def set_html(self, words: str, alerts: str = "") -> None:
        """HTML of the state and of the alerts, sent where it differs."""
        for place, content in ((self._words, words), (self._alerts, alerts)):
            if place.content != content:
                place.content = content


class OperatorControls:
    """Controls that move the robot; disabled until this tab took the lease, by a button and a question."""

    def __init__(self, site: ViewerSite, place: str | None) -> None:
        self._server = site.server
        self._hold = site.channel.hold
        self._robot: Message = {}
        self._key = ""  # that only the page of the lease's tab shows; "": no tab has it
        self._shown_key: Any = None
        server = site.server
        gui = server.gui
        with gui.add_folder("operate"):
            self._take = gui.add_button("Take the lease ...", color="blue")
            self._give = gui.add_button("Give the lease back", disabled=True)
            self._arm = gui.add_button("Arm", disabled=True)
            self._disarm = gui.add_button("Disarm", disabled=True)
            self._motion = gui.add_dropdown("motion", options=("none",), initial_value="none")
            self._play = gui.add_button("Play", disabled=True)
            self._rest = gui.add_button("Rest pose", disabled=True)
        self._operator = OperatorThread(place, self._changed)
        self._take.on_click(self._ask_first)
        self._give.on_click(self._press(lambda tab, tell: self._operator.give(tab, tell)))
        self._arm.on_click(self._press_for(lambda: operator_lease.arm))
        self._disarm.on_click(self._press_for(lambda: operator_lease.disarm))
        self._play.on_click(self._press_for(self._chosen))
        self._rest.on_click(self._press_for(lambda: operator_lease.to_rest(self._robot)))
        server.on_client_disconnect(self._on_client_left)
        site.channel.begin = self._jog

    def set_robot(self, robot: Message) -> None:
        """The motions of another robot."""
        self._robot = robot
        names = operator_lease.motions(robot) or ("none",)
        if tuple(self._motion.options) != names:
            self._motion.options = names
            self._motion.value = names[0]

    def _jog(self, press: Press, key: str, request: JogRequest, tell: Tell) -> None:
        """A button is held in the page that shows `key`. In the server's loop."""
        tab = self._operator.holder
        if tab is None or not self._key or not hmac.compare_digest(key.encode(), self._key.encode()):
            tell(StopOutcome(False, ReasonCode.LEASE_MISSING, NO_LEASE))
            return
        self._operator.call(tab, jog(self._robot, request, self._hold, press), tell)

    def _chosen(self) -> Work | None:
        name = str(self._motion.value)
        return operator_lease.play(self._robot, name) if name in operator_lease.motions(self._robot) else None

    async def _ask_first(self, event: Any) -> None:
        """Ask in this tab alone: one wrong click must not take a lease."""
        gui = event.client.gui
        modal = gui.add_modal("Take the lease?")
        with modal:
            gui.add_html(
                '<p style="padding:0 1em">This tab then moves the robot. Others cannot until it gives the '
                "lease back or is closed. Is nobody within its reach?</p>"
            )
            yes = gui.add_button("Take it", color="blue")
            no = gui.add_button("Leave it")

        async def take(_: Any) -> None:
            modal.close()
            self._operator.take(event.client.client_id, teller(event.client))

        async def leave(_: Any) -> None:
            modal.close()

        yes.on_click(take)
        no.on_click(leave)

    def _press(self, do: Callable[[int, Callable[[StopOutcome], None]], None]) -> ButtonPress:
        async def press(event: Any) -> None:
            if event.client is not None:
                do(event.client.client_id, teller(event.client))

        return press

    def _press_for(self, what: Callable[[], Work | None]) -> ButtonPress:
        def do(tab: int, tell: Callable[[StopOutcome], None]) -> None:
            work = what()
            if work is not None:
                self._operator.call(tab, work, tell)

        return self._press(do)

    async def _on_client_left(self, client: Any) -> None:
        self._operator.on_tab_closed(client.client_id)

    def _changed(self, tab: int | None) -> None:
        """In the operator's thread."""
        held = tab is not None
        client = self._server.get_clients().get(tab)
        if tab is not None and client is None:
            self._operator.on_tab_closed(tab)
        elif tab is not None:
            threading.Thread(target=self._look_after, args=(tab, client), daemon=True).start()
        self._show_key(client if held else None)
        self._take.disabled = held
        for button in (self._give, self._arm, self._disarm, self._play, self._rest):
            button.disabled = not held

    def _show_key(self, client: Any) -> None:
        """A new key in the page of this client; None: in no page."""
        if self._shown_key is not None:
            with contextlib.suppress(Exception):  # its tab is gone
                self._shown_key.remove()
        self._shown_key = None
        self._key = "" if client is None else secrets.token_urlsafe(16)
        if client is not None:
            self._shown_key = client.gui.add_html(f'<span hidden data-twind-key="{self._key}"></span>')

    def _look_after(self, tab: int, client: Any) -> None:
        """The page answers what it keeps under a name: nothing, but it answers."""
        operator_lease.look_after(
            self._operator, tab, lambda: client.local_storage.get_item("twind", timeout=operator_lease.ANSWER)
        )
