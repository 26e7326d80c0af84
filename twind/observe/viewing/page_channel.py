"""WebSocket of the page's own script: stops, presses and heartbeats in, tokens and joint values out.

viser's buttons know neither a release nor a hidden tab, and its messages wait in its queues. This channel
goes through the same access check. It runs in the web server's loop and waits for nothing there.
"""

import asyncio
import contextlib
import itertools
import json
import time
from collections.abc import Callable, Mapping
from functools import partial
from math import isfinite
from typing import Any

from twind.observe.viewing.dead_man_hold import BEAT, DeadManHold, Press
from twind.observe.viewing.stop_threads import StopAction, StopOutcome, Tell
from twind.robot_client.jog_motion import JogRequest

PATH = "/twind"  # behind the secret
LARGEST = 1000  # characters of a message
VALUES = 3  # tokens between two messages with joint values

Begin = Callable[[Press, str, JogRequest, Tell], None]  # with the key of the lease that the page shows


def refuse_jog(press: Press, key: str, request: JogRequest, tell: Tell) -> None:
    """Refuse a press: this page only shows the robot."""
    tell(
        StopOutcome(False, "not moved", "this page only shows the robot: `twindctl view --operate` moves it")
    )


class PageChannel:
    """State that the connections of all pages share."""

    def __init__(self) -> None:
        self.hold = DeadManHold()
        self.begin: Begin = refuse_jog
        self.stops: Mapping[str, StopAction] = {}  # buttons that each page has, by name
        self.values = "{}"  # newest joint values as JSON, replaced by another thread
        self._numbers = itertools.count(1)

    async def serve(self, connection: Any) -> None:
        """One connection, until it ends: a tab with a number of its own."""
        from websockets.exceptions import ConnectionClosedError

        tab = PageTab(self, connection, next(self._numbers))
        sending = asyncio.create_task(tab.send())
        try:
            async for message in connection:
                tab.take(message)
        except (ValueError, TypeError, KeyError, OverflowError, RecursionError):  # not of our script: closed
            pass
        except ConnectionClosedError:  # the browser was killed, or its machine sleeps
            pass
        finally:
            self.hold.forget(tab.number)
            sending.cancel()
            await asyncio.gather(sending, return_exceptions=True)


class PageTab:
    """One connection. Nothing that it sends is waited for."""

    def __init__(self, channel: PageChannel, connection: Any, number: int) -> None:
        self.number = number
        self._channel = channel
        self._connection = connection
        # the newest
        self._press = Press(number, 0)
        self._request = JogRequest("", "")
        self._loop = asyncio.get_running_loop()
        self._answers: set[asyncio.Task[None]] = set()

    async def send(self) -> None:
        """Tokens for the newest press; now and then the joint values, where they changed."""
        await self._send(stops=list(self._channel.stops))
        shown = ""
        for turn in itertools.count():
            token = self._channel.hold.issue(self._press, time.monotonic())
            if token is not None:
                await self._send(press=self._press.number, token=token)
            values = self._channel.values
            if turn % VALUES == 0 and values != shown:
                shown = values
                await self._connection.send(values)
            await asyncio.sleep(BEAT)

    def take(self, message: Any) -> None:
        """One message of the page. Raises as `serve` expects where it is none."""
        told = json.loads(message if len(message) <= LARGEST else "")
        press = Press(self.number, int(told["press"]))
        match told:
            case {"stop": str(name)}:
                self._channel.hold.end_all()
                self._channel.stops[name].ask(partial(self._tell, press, stop=name))
            case {"token": int(token)}:
                self._channel.hold.beat(press, token, time.monotonic())
            case {"kind": str(kind), "name": str(name), "key": str(key)}:
                self._begin(press, key, JogRequest(kind, name, _finite(told.get("value", 0.0))))
            case {"value": value}:
                if press == self._press:
                    self._request.value = _finite(value)
            case _:
                self._channel.hold.release(press)

    def _begin(self, press: Press, key: str, request: JogRequest) -> None:
        def tell(outcome: StopOutcome) -> None:
            self._channel.hold.end(press)
            self._tell(press, outcome)

        if self._channel.hold.press(press, time.monotonic()):
            self._press = press
            self._request = request
            self._channel.begin(press, key, request, tell)
        else:
            self._tell(press, StopOutcome(False, "not moved", "another button is held"))

    def _tell(self, press: Press, outcome: StopOutcome, **more: str) -> None:
        """Send the outcome of a press; from any thread."""
        words = {"press": press.number, "done": outcome.done, "title": outcome.title, "text": outcome.text}
        self._loop.call_soon_threadsafe(self._answer, words | more)

    def _answer(self, words: Mapping[str, Any]) -> None:
        task = self._loop.create_task(self._send(**words))
        self._answers.add(task)
        task.add_done_callback(self._answers.discard)

    async def _send(self, **message: Any) -> None:
        with contextlib.suppress(Exception):  # the tab is gone: `serve` ends
            await self._connection.send(json.dumps(message))


def _finite(value: Any) -> float:
    """Return a number of a message. Raises ValueError, TypeError."""
    if not isfinite(number := float(value)):
        raise ValueError("not finite")
    return number
