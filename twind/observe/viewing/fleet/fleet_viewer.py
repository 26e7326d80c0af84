"""Several robots side by side: this thread draws, the threads of the registry receive."""

import threading
import time
import traceback
from collections import defaultdict
from typing import Any

from twind.client.monitor_stream import RepeatedFaultFilter
from twind.observe.viewing import status_html
from twind.observe.viewing.fleet.fleet_page import FleetPage
from twind.observe.viewing.fleet.fleet_robot_place import APART, FleetRobotPlace, camera, spots
from twind.observe.viewing.fleet.robot_health import RobotHealth, described, summary
from twind.observe.viewing.fleet.robot_registry import Found, RegisteredRobot, RobotRegistry
from twind.observe.viewing.viewer_access import ViewerSite
from twind.observe.viewing.viewer_run import Drawing, served

PERIOD = 0.1  # s between pictures
WORDS = 3  # pictures between two drawings of words


def watch(found: Found, *, port: int | None = None, open_page: bool = False, as_json: bool = False) -> int:
    """All robots that `found` ever names, on one page; until Ctrl-C or SIGTERM.

    It is asked once a second. Who is gone stays on the page, grey. Nothing can be done to them but stop and
    e-stop. Raises Rejected where no server can be started.
    """

    def begun(site: ViewerSite) -> Drawing:
        return FleetViewer(site.server, found).run

    return served(begun, title="twind", port=port, open_page=open_page, as_json=as_json)


class FleetViewer:
    """One page of a server, and the robots on it."""

    def __init__(self, server: Any, found: Found) -> None:
        self._server = server
        self._company = RobotRegistry(found)
        self._page = FleetPage(server, self._company)
        self._stands: dict[str, FleetRobotPlace] = {}
        self._hows: dict[str, RobotHealth] = {}
        self._traced: dict[str, RepeatedFaultFilter] = defaultdict(
            RepeatedFaultFilter
        )  # by name; "": of no robot
        self._laid: tuple[int, float] = (0, 0.0)  # how many stand how far apart
        self._turn = 0
        server.scene.add_grid(
            "/floor", infinite_grid=True, fade_distance=30.0, plane_opacity=0.3, shadow_opacity=0.2
        )

    def run(self, ended: threading.Event) -> None:
        """Draw until `ended`."""
        while not ended.wait(PERIOD):
            try:
                self.draw()
            except Exception as error:  # noqa: BLE001  the stop buttons end with this process
                self._trace("", error)
        self._company.close()

    def draw(self) -> None:
        """Draw one picture, if a browser is connected."""
        if not self._server.get_clients():
            return
        members = self._company.members
        self._turn += 1
        with self._server.atomic():
            hows = [self._update_robot(each) for each in members]
            self._lay()
            if self._turn % WORDS == 1:
                self._page.set_html(self._problem() + summary(hows))
        self._server.flush()

    def _update_robot(self, member: RegisteredRobot) -> RobotHealth:
        """Whatever is wrong with one is not the others' trouble."""
        if member.name not in self._stands:
            self._stands[member.name] = FleetRobotPlace(self._server.scene, len(self._stands), member.name)
            self._page.add(member)
        stand = self._stands[member.name]
        now = member.known.now()
        if self._turn % WORDS == 1 or member.name not in self._hows:
            self._hows[member.name], said = described(now, stand.problem)
            self._page.set_html(said, member.name)
        how = self._hows[member.name]
        try:
            stand.draw(now, how)
        except Exception as error:  # noqa: BLE001
            self._trace(member.name, error)
            stand.failed(error)
        return how

    def _trace(self, name: str, error: Exception) -> None:
        """Once for each reason: a robot may say the same ten times a second."""
        if self._traced[name].is_transition(f"{type(error).__name__}: {error}", time.monotonic()):
            traceback.print_exception(error)

    def _lay(self) -> None:
        """Anew where there are more or larger ones; then all are looked at."""
        stands = list(self._stands.values())
        size = max((each.size for each in stands), default=0.0)
        if self._laid == (len(stands), size):
            return
        self._laid = len(stands), size
        places = spots(len(stands), APART * size)
        for stand, place in zip(stands, places, strict=True):
            stand.to(place)
        where, what = camera(places, size)
        for each in (self._server.initial_camera, *(c.camera for c in self._server.get_clients().values())):
            each.position = tuple(where)
            each.look_at = tuple(what)

    def _problem(self) -> str:
        why = self._company.problem
        return status_html.block([status_html.row("looking for robots", why, status_html.RED)]) if why else ""
