"""The viewer from the first line it prints to its end: of a daemon, or of messages from elsewhere."""

import json
import sys
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager

from twind.client import Client
from twind.command_line.stop_signals import catch_stop_signals
from twind.command_line.verb import DONE, Rejected
from twind.exceptions import OperationFailed
from twind.observe.viewing.daemon_messages import messages
from twind.observe.viewing.robot_connections import local, observer
from twind.observe.viewing.robot_page import OperatorControls, RobotPage
from twind.observe.viewing.robot_viewer import RobotViewer, in_browser, run
from twind.observe.viewing.stop_threads import BOUND, StopThreads
from twind.observe.viewing.viewer_access import ViewerSite, opened
from twind.observe.viewing.viewer_state import Message, News, RobotAnnounced, ViewerState

Drawing = Callable[[threading.Event], None]  # draws until it is set


def show(robot: Message, messages: Iterable[Message], *, title: str) -> int:
    """Show messages in the form of `Monitor`, of the robot in the form of `GetRobot`, until Ctrl-C.

    They are shown as they come: their source keeps the time. A thread of its own reads them.
    Raises Rejected if no server can be started.
    """

    def news() -> Iterator[News]:
        yield RobotAnnounced(robot)
        yield from messages

    def begun(site: ViewerSite) -> Drawing:
        known = ViewerState()
        viewer = RobotViewer(site, known, RobotPage(site, known, None))
        return lambda ended: run(viewer, known, news(), ended)

    return served(begun, title=title)


def watch(
    place: str | None,
    *,
    port: int | None = None,
    open_page: bool = False,
    operate: bool = False,
    wait: bool = False,
    as_json: bool = False,
) -> int:
    """Show the daemon whose sockets are in the folder `place`, and its successors, until Ctrl-C or SIGTERM.

    Raises ClientError without a daemon unless `wait` is set, Rejected if no server can be started.
    """
    ways = local(place)
    if not wait:
        with closing(observer(ways, BOUND)) as client:
            client.call("GetStatus")
    if operate and not wait:
        with closing(Client(place)) as operator:
            operator.connect()  # a missing permission is reported now, not at the first press

    def begun(site: ViewerSite) -> Drawing:
        known = ViewerState()
        page = RobotPage(site, known, StopThreads(ways))
        viewer = RobotViewer(site, known, page, OperatorControls(site, place) if operate else None)
        return lambda ended: run(viewer, known, messages(ways, ended), ended)

    return served(begun, title="twind", port=port, open_page=open_page, as_json=as_json)


def served(
    begun: Callable[[ViewerSite], Drawing],
    *,
    title: str,
    port: int | None = None,
    open_page: bool = False,
    as_json: bool = False,
) -> int:
    """A page, its address printed, drawn until Ctrl-C or SIGTERM. Raises Rejected where no server can be
    started."""
    with (
        catch_stop_signals() as ended,
        tempfile.TemporaryDirectory(prefix="twind-view-") as folder,
        _site(port, title) as site,
    ):
        draw = begun(site)
        _print_address(site, as_json=as_json)
        if open_page:
            in_browser(site.url, folder)
        draw(ended)
    return DONE


@contextmanager
def _site(port: int | None, title: str) -> Iterator[ViewerSite]:
    try:
        with opened(port, title) as site:
            yield site
    except OperationFailed as error:
        raise Rejected(str(error)) from None


def _print_address(site: ViewerSite, *, as_json: bool) -> None:
    print(json.dumps({"url": site.url}) if as_json else f"view      {site.url}", flush=True)
    if not as_json and sys.stdout.isatty():
        print("          for you alone: whoever has this address can stop the robot; Ctrl-C ends the viewer")
