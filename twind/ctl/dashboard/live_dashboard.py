"""The picture, live: a thread takes the news, this one draws at its own pace, so that news never pile up."""

import os
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace

from rich.console import Console

from twind.client import Client, ClientError
from twind.client.monitor_stream import AGAIN, monitor_messages
from twind.command_line.verb import DONE
from twind.ctl.dashboard.dashboard_layout import PAGES, PageSelection, picture
from twind.ctl.dashboard.dashboard_renderer import Palette, plain
from twind.ctl.dashboard.dashboard_state import DashboardState, MonitorCollector
from twind.ctl.dashboard.terminal_screen import TerminalScreen, is_live
from twind.robot.event_codes import EventCode

TOPICS = ("status", "state", "latency", "events", "verdicts")
FASTEST = 15.0  # pictures a second
STEP = 5  # joints that an arrow key moves by
PLAIN_WIDTH = 120  # columns where there is no terminal, unless COLUMNS is set


class MonitorFeed:
    """Takes the news of one daemon after the other, in a thread of its own."""

    def __init__(self, connect: Callable[[], Client], rate: float) -> None:
        """Raises ClientError where there is no daemon to begin with."""
        self.watched = MonitorCollector(patience=max(1.5, 3.0 / rate))
        self.failure: ClientError | None = None  # the first daemon did not answer
        self._connect = connect
        self._ended = threading.Event()
        self._first: Client | None = self._greet()
        self._rate = rate
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Take no more news. What waits for an answer ends with the process."""
        self._ended.set()
        self._thread.join(0.5)

    def _greet(self) -> Client:
        """A connection, and what is known of its robot."""
        client = self._connect()
        self.watched.robot(client.call("GetRobot")["robot"])
        return client

    def _next(self) -> Client:
        first = self._first
        self._first = None
        return first if first is not None else self._greet()

    def _read(self) -> None:
        """Read until the end, whatever a daemon sends: a dead thread would leave an old picture."""
        while not self._ended.is_set():
            try:
                self._follow()
            except Exception as error:  # noqa: BLE001
                why = _make_client_error(error)
                if not self.watched.is_complete:
                    self.failure = why
                    return
                self.watched.record_disconnect(str(why), time.monotonic())
                self._ended.wait(AGAIN)

    def _follow(self) -> None:
        watched = self.watched
        for news in monitor_messages(
            self._next, TOPICS, self._rate, lambda why: watched.record_disconnect(why, time.monotonic())
        ):
            if self._ended.is_set():
                return
            watched.take(news, time.monotonic())
            if news["topic"] == "events" and news["event"]["code"] == EventCode.RELOADED:
                self._greet().close()  # on a connection of its own: this one streams


def _make_client_error(error: Exception) -> ClientError:
    if isinstance(error, ClientError):
        return error
    return ClientError(f"a message of the daemon is unreadable: {type(error).__name__}: {error}")


def show(connect: Callable[[], Client], rate: float, count: int | None = None) -> int:
    """Pictures, `count` of them or until q. Raises ClientError where there is no daemon to begin with."""
    feed = MonitorFeed(connect, rate)
    try:
        _await_news(feed)
        if is_live():
            _draw(feed, rate, count)
        else:
            _print(feed, rate, count)
    finally:
        feed.close()
    return DONE


def _await_news(feed: MonitorFeed) -> None:
    while not feed.watched.is_complete:
        if feed.failure is not None:
            raise feed.failure
        time.sleep(0.01)


def _print(feed: MonitorFeed, rate: float, count: int | None) -> None:
    """Plain text, everything there is, a picture for each news that there is time for."""
    width = int(os.environ.get("COLUMNS") or 0) or PLAIN_WIDTH
    period = 1.0 / min(rate, FASTEST)
    shown = 0
    seen = -1
    while count is None or shown < count:
        if feed.watched.count == seen:
            time.sleep(0.01)
            continue
        seen = feed.watched.count
        shown = shown + 1
        now = time.monotonic()
        print(plain(picture(feed.watched.view(now), width, None)) + "\n", flush=True)
        if shown != count:
            time.sleep(max(0.0, now + period - time.monotonic()))


def _draw(feed: MonitorFeed, rate: float, count: int | None) -> None:
    """On a terminal, until a key ends it."""
    palette = Palette.for_console(Console(file=sys.stdout))
    period = 1.0 / min(rate, FASTEST)
    shown = PageSelection()
    pictures = 0
    frozen: DashboardState | None = None
    with TerminalScreen().entered() as screen:
        due = time.monotonic()
        while True:
            now = time.monotonic()
            if now >= due:
                due = max(due + period, now)
                pictures += 1
            size = screen.size()
            lines = picture(frozen or feed.watched.view(now), *size, shown, now)
            screen.draw([palette.text(each) for each in lines], size)
            if pictures == count:
                return
            for key in screen.wait(due - time.monotonic()):
                if key == "quit":
                    return
                shown = apply_key(shown, key, now, len(feed.watched.view(now).joints))
                if key == "freeze":
                    frozen = feed.watched.view(now) if frozen is None else None


def apply_key(shown: PageSelection, key: str, now: float, joints: int) -> PageSelection:
    """The selection after a key, for a robot of `joints` joints."""
    pages = list(PAGES)
    if key == "page":
        return replace(shown, page=pages[(pages.index(shown.page) + 1) % len(pages)], offset=0)
    if key == "freeze":
        return replace(shown, frozen_since=now if shown.frozen_since is None else None)
    step = {"up": -STEP, "down": STEP}.get(key, 0)
    return replace(shown, offset=max(0, min(joints - 1, shown.offset + step)))
