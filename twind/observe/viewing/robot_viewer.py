"""Viewer of messages until it is ended: one thread takes them, this one draws. Neither is waited for."""

import contextlib
import threading
import traceback
import webbrowser
from collections.abc import Iterable
from pathlib import Path

from twind.exceptions import InvalidInput
from twind.observe.viewing import status_html
from twind.observe.viewing.joint_html import joint_values
from twind.observe.viewing.model_page import ModelPage
from twind.observe.viewing.robot_model import RobotModel
from twind.observe.viewing.robot_page import OperatorControls, RobotPage
from twind.observe.viewing.robot_scene import RobotScene, camera
from twind.observe.viewing.viewer_access import ViewerSite
from twind.observe.viewing.viewer_state import DaemonLost, Message, News, ViewerSnapshot, ViewerState

PERIOD = 1.0 / 30.0  # s between pictures
# pictures between two drawings of plots (10 Hz) and of words (5 Hz)
PLOTS = 3
WORDS = 6


class RobotViewer:
    """One robot behind one site."""

    def __init__(
        self,
        site: ViewerSite,
        known: ViewerState,
        page: RobotPage | ModelPage,
        controls: OperatorControls | None = None,
    ) -> None:
        self._site = site
        self._server = site.server
        self._known = known
        self._page = page
        self._controls = controls
        self._scene: RobotScene | None = None
        self._told: Message | None = None
        self._problem = ""
        self._broken = ""  # why nothing more of this robot is drawn
        self._turn = 0

    def draw(self) -> None:
        """Draw one picture, if a browser is connected."""
        if not self._server.get_clients():
            return
        now = self._known.now()
        if now.told is not None and now.told is not self._told:
            self._describe(now.told)
        if now.joints is not None:
            told = now.joints
            self._site.channel.values = joint_values(told.measured, told.goal, told.external, told.contact)
        with self._server.atomic():
            if self._scene is not None:
                self._scene.draw(now, self._page.ghost)
            self._turn += 1
            if self._turn % PLOTS == 0 and not self._broken:
                self._page.draw()
            if self._turn % WORDS == 1:
                self._page.set_html(self._words(now), status_html.alerts(now))
        self._server.flush()

    def failed(self, error: Exception) -> None:
        """Stop drawing this robot after `error` and show the error as text; the buttons stay."""
        if not self._broken:
            traceback.print_exception(error)
        self._broken = f"the picture cannot be drawn: {type(error).__name__}: {error}"
        scene = self._scene
        self._scene = None
        with contextlib.suppress(Exception):
            if scene is not None:
                scene.remove()
        with contextlib.suppress(Exception):
            self._page.set_html(status_html.row("picture", self._broken, status_html.RED))

    def _describe(self, description: Message) -> None:
        """Build the scene of the robot described by `description`, if the description draws another one."""
        self._told = description
        if self._scene is not None and self._scene.likeness.same_as(description):
            return
        if self._scene is not None:
            self._scene.remove()
        self._scene = None
        self._problem = ""
        self._broken = ""
        try:
            likeness = RobotModel(description)
        except InvalidInput as error:
            self._problem = str(error)
            return
        self._scene = RobotScene(self._server.scene, likeness, "/robots/0")
        self._page.set_robot(description["robot"], jogs=self._controls is not None)
        if self._controls is not None:
            self._controls.set_robot(description["robot"])
        self._look(likeness)

    def _look(self, model: RobotModel) -> None:
        """Set the cameras so that all of the robot is seen."""
        where, what = camera(model)
        camera_of_all = self._server.initial_camera
        camera_of_all.position = tuple(where)
        camera_of_all.look_at = tuple(what)
        for client in self._server.get_clients().values():
            client.camera.position = tuple(where)
            client.camera.look_at = tuple(what)

    def _words(self, now: ViewerSnapshot) -> str:
        scene = self._scene
        if scene is None:
            what = "picture" if self._broken else "model"
            problem = self._broken or self._problem
            problem = status_html.row(what, problem, status_html.RED) if problem else ""
            return problem + status_html.page(now, None, None, 0)
        return status_html.page(now, scene.likeness, scene.near, scene.contacts)


def run(viewer: RobotViewer, known: ViewerState, news: Iterable[News], ended: threading.Event) -> None:
    """Until `ended`. When the messages end the last picture stays."""
    taker = threading.Thread(target=take, args=(known, news), name="news", daemon=True)
    taker.start()
    while not ended.wait(PERIOD):
        try:
            viewer.draw()
        except Exception as error:  # noqa: BLE001  the stop buttons end with this process
            viewer.failed(error)


def take(known: ViewerState, news: Iterable[News]) -> None:
    """Pass all messages to `known`. One that cannot be parsed is reported: a picture that stands still must
    not look live."""
    why = "the messages have ended"
    traced = False
    try:
        for each in news:
            try:
                known.take(each)
            except Exception as error:  # noqa: BLE001  the next message may be one
                known.take(DaemonLost(f"a message cannot be understood: {type(error).__name__}: {error}"))
                if not traced:
                    traceback.print_exc()
                traced = True
    except Exception as error:  # noqa: BLE001
        traceback.print_exc()
        why = f"the messages have ended: {type(error).__name__}: {error}"
    known.take(DaemonLost(why))


def in_browser(url: str, folder: str) -> None:
    """Open `url` in the user's browser, by a file that only this user may read: a command line is readable by
    every user."""
    page = Path(folder) / "twind-view.html"
    page.touch(0o600)
    page.write_text(f'<meta http-equiv="refresh" content="0;url={url}"><a href="{url}">the viewer</a>')
    webbrowser.open(page.as_uri())
