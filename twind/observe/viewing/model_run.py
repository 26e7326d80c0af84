"""Viewer of a robot file, without a daemon or with the angles of one that mirrors the limp robot."""

import threading
import time
from collections.abc import Iterator

from twind.command_line.verb import Rejected
from twind.exceptions import InvalidInput
from twind.observe.viewing.daemon_messages import messages
from twind.observe.viewing.model_page import ModelPage
from twind.observe.viewing.robot_connections import RobotConnections
from twind.observe.viewing.robot_model import RobotModel
from twind.observe.viewing.robot_viewer import PERIOD, RobotViewer, run
from twind.observe.viewing.viewer_access import ViewerSite
from twind.observe.viewing.viewer_run import Drawing, served
from twind.observe.viewing.viewer_state import DaemonLost, Message, News, RobotAnnounced, ViewerState


def show_model(
    description: Message,
    ways: RobotConnections | None,
    *,
    port: int | None = None,
    open_page: bool = False,
    as_json: bool = False,
) -> int:
    """Show the robot of `description`, in the form of `GetRobot`, until Ctrl-C.

    `ways`: to a daemon that is mirrored. Raises Rejected: no model, or no server can be started.
    """
    try:
        model = RobotModel(description)
    except InvalidInput as error:
        raise Rejected(str(error)) from None

    def begun(site: ViewerSite) -> Drawing:
        known = ViewerState()
        page = ModelPage(site.server, known, model, live=ways is not None)
        viewer = RobotViewer(site, known, page)

        def draw(ended: threading.Event) -> None:
            news = _slid(page, ended) if ways is None else _mirrored(page, ways, ended)
            known.take(RobotAnnounced(description))
            run(viewer, known, news, ended)

        return draw

    return served(begun, title=model.name, port=port, open_page=open_page, as_json=as_json)


def _slid(page: ModelPage, ended: threading.Event) -> Iterator[News]:
    """States with the angles of the sliders."""
    while not ended.is_set():
        yield page.message()
        time.sleep(PERIOD)


def _mirrored(page: ModelPage, ways: RobotConnections, ended: threading.Event) -> Iterator[News]:
    """States and status of the daemon; the description of its robot is left out."""
    for news in messages(ways, ended, topics=("state", "status", "events")):
        if isinstance(news, DaemonLost):
            yield news
        elif not isinstance(news, RobotAnnounced):
            yield page.live_message(news) if news["topic"] == "state" else news
