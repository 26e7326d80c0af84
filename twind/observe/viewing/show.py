"""The viewer from the first line it prints to its end: of a daemon, or of messages from elsewhere."""

import json
import signal
import sys
import tempfile
import threading
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager
from types import FrameType

from twind.client import Client
from twind.ctl.verb import DONE, Rejected
from twind.observe.viewing.door import DoorError, Site, opened
from twind.observe.viewing.live import messages, observer
from twind.observe.viewing.news import Described, Known, Message, News
from twind.observe.viewing.page import Controls, Page
from twind.observe.viewing.stops import BOUND, Stops
from twind.observe.viewing.viewer import Viewer, in_browser, run


def show(
    robot: Message,
    messages: Iterable[Message],
    *,
    title: str,
    port: int | None = None,
    open_page: bool = False,
    as_json: bool = False,
) -> int:
    """Messages as `Monitor` gives them, of the robot that `GetRobot` would describe; until Ctrl-C.

    They are shown as they come: whoever gives them keeps the time. They are asked for in a thread of their
    own. Raises Rejected where no server can be started.
    """

    def news() -> Iterator[News]:
        yield Described(robot)
        yield from messages

    known, ended = Known(), _until_told()
    with tempfile.TemporaryDirectory(prefix="twind-view-") as folder, _site(port, title) as site:
        _say(site, as_json=as_json)
        if open_page:
            in_browser(site.url, folder)
        run(Viewer(site, known, Page(site.server, known, None)), known, news(), ended)
    return DONE


def watch(
    place: str | None,
    *,
    port: int | None = None,
    open_page: bool = False,
    operate: bool = False,
    wait: bool = False,
    as_json: bool = False,
) -> int:
    """The daemon whose sockets are in the folder `place`, and whoever comes after it; until Ctrl-C or
    SIGTERM.

    Raises ClientError where none is there now and `wait` is not asked for, Rejected where no server can be
    started.
    """
    if not wait:
        with closing(observer(place, BOUND)) as client:
            client.call("GetStatus")
    if operate and not wait:
        with closing(Client(place)) as operator:
            operator.connect()  # whoever may not is told now, not at the first press
    known, ended = Known(), _until_told()
    with tempfile.TemporaryDirectory(prefix="twind-view-") as folder, _site(port, "twind") as site:
        page = Page(site.server, known, Stops(place))
        viewer = Viewer(site, known, page, Controls(site.server, place) if operate else None)
        _say(site, as_json=as_json)
        if open_page:
            in_browser(site.url, folder)
        run(viewer, known, messages(place, ended), ended)
    return DONE


@contextmanager
def _site(port: int | None, title: str) -> Iterator[Site]:
    try:
        with opened(port, title) as site:
            yield site
    except DoorError as error:
        raise Rejected(str(error)) from None


def _until_told() -> threading.Event:
    """Set by Ctrl-C, SIGTERM, or the end of the terminal."""
    ended = threading.Event()

    def end(_number: int, _frame: FrameType | None) -> None:
        ended.set()

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, end)
    return ended


def _say(site: Site, *, as_json: bool) -> None:
    print(json.dumps({"url": site.url}) if as_json else f"view      {site.url}", flush=True)
    if not as_json and sys.stdout.isatty():
        print("          for you alone: whoever has this address can stop the robot; Ctrl-C ends the viewer")
