"""Stops, modes and queries from ROS: each a call of the daemon. Standard library, Python 3.10.

A stop waits neither for a change of the mode nor for the check of a trajectory. Arming is not among them: it
requires an operator beside the robot.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from typing import Any

from twind.bridge.ros.ros_command_queue import Report
from twind.bridge.ros.ros_endpoints import (
    E_STOP,
    GET_STATUS,
    SET_LIVE,
    SET_MODE,
    STOP,
    TO_E_STOP,
    TO_MODE,
    TO_STOP,
    RosService,
    RosTopic,
)
from twind.client import CallError, Client, ClientError, NoDaemon
from twind.exceptions import InvalidInput
from twind.ros import STRING, decode

PATIENCE = 35.0  # s for an answer; an e-stop answers when its first effect is confirmed, within 30
SOON = 2.0  # s for an answer that waits for nothing
LEVELS = ("settle", "cut")
REASON = "requested over ROS"

KEPT = 2  # different requests of one kind that wait
# s from one to the next; an e-stop has none
MODE_PACE = 1.0
STOP_PACE = 0.1

Ask = Callable[[], Client]
STOPPING = "stopping: the robot decelerates and holds"


class CoalescingExecutor:
    """Executor of requests in a separate thread, the newest last. Equal waiting requests run once."""

    def __init__(
        self, name: str, do: Callable[[str], None], tell: Callable[[str], None], pace: float = 0.0
    ) -> None:
        """Make the executor; `tell` gets a line if `do` raised. `pace`: s between two calls."""
        self._do = do
        self._tell = tell
        self._pace = pace
        self._what: list[str] = []
        self._condition = threading.Condition()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def ask(self, what: str) -> None:
        """Returns at once."""
        with self._condition:
            self._what = [*(each for each in self._what if each != what), what][-KEPT:]
            self._condition.notify()

    def _run(self) -> None:
        while True:
            with self._condition:
                self._condition.wait_for(lambda: self._what)
                what = self._what.pop(0)
            try:
                self._do(what)
            except Exception as error:  # noqa: BLE001  the next stop is done all the same
                with suppress(Exception):
                    self._tell(f"{self._thread.name}: {type(error).__name__}: {error}")
            time.sleep(self._pace)


class RosServiceCalls:
    """Service calls. Any thread may call `on_message`, which returns at once, and `handle_request`."""

    def __init__(
        self,
        operator: Ask,
        observer: Ask,
        stopping: Callable[[], None],
        status: Callable[[Mapping[str, Any] | str], str],
        closed: Callable[[bool], str],
        on_result: Report,
        tell: Callable[[str], None],
    ) -> None:
        """Make the calls; `operator`, `observer` make connections; `stopping` is called before each stop.

        `status`: the text of /bridge/status from the daemon's status, or its absence. `closed`: why
        no stop (True), or no mode is taken; "": it is. `on_result` gets the results of topics, `tell` a
        line where even that fails.
        """
        self._operator = operator
        self._observer = observer
        self._stopping = stopping
        self._status = status
        self._closed = closed
        self._on_result = on_result
        self._stop = CoalescingExecutor(
            "stop", lambda _: self._log_outcome(STOP, "", self.stop()), tell, STOP_PACE
        )
        self._mode = CoalescingExecutor(
            "mode",
            lambda mode: self._log_outcome(SET_MODE, mode, self._set_mode_by_name(mode)),
            tell,
            MODE_PACE,
        )
        # One each: a cut is requested because the robot does not settle, so it must not wait for that.
        self._e_stops = {
            level: CoalescingExecutor(f"e-stop {level}", partial(self._e_stop_by_topic, level), tell)
            for level in LEVELS
        }

    def start(self) -> None:
        """Start the threads for requests by topic."""
        for call in (*self._e_stops.values(), self._stop, self._mode):
            call.start()

    def on_message(self, topic: RosTopic, data: bytes) -> None:
        """Handle a message of a topic. An invalid one changes no mode, but any stop message stops."""
        try:
            text = str(decode(STRING, data)["data"]).strip()
        except InvalidInput:
            text = ""
        if topic is E_STOP:
            self._e_stops[text if text in LEVELS else LEVELS[0]].ask("")
        elif topic is STOP:
            self._stop.ask("")
        else:
            self._mode.ask(text[:80])

    def handle_request(self, service: RosService, data: bool | None) -> tuple[bool, str]:
        """Handle a request of a service; return success, and a text. Waits for the daemon."""
        if service is GET_STATUS:
            return True, self._status(self._request_status())
        if service is TO_STOP:
            return self.stop()
        if service is TO_E_STOP:
            return self.e_stop(LEVELS[0])
        if service is SET_LIVE:
            return self.set_mode("live" if data else "mirror")
        return self.set_mode(next(mode for mode, known in TO_MODE.items() if known is service))

    def stop(self) -> tuple[bool, str]:
        """Decelerate and hold."""
        why = self._closed(True)
        if why:
            return False, why
        self._stopping()
        done, message = self._call(self._operator, "Cancel")
        # The state in the answer does not include the motion.
        return done, STOPPING if done else message

    def e_stop(self, level: str) -> tuple[bool, str]:
        """Stop now. It latches: resetting it (`twindctl reset`) requires an operator beside the robot."""
        self._stopping()
        outcome = False, ""
        for connect in (self._observer, self._operator):  # the one may have no place left, or not answer
            outcome = self._call(connect, "EStop", level=level, reason=REASON)
            if outcome[0]:
                break
        return outcome

    def set_mode(self, mode: str) -> tuple[bool, str]:
        """Set the mode: sim, mirror, live. It does not arm."""
        why = self._closed(False)
        return (False, why) if why else self._call(self._operator, "SetMode", mode=mode)

    def _request_status(self) -> Mapping[str, Any] | str:
        """Return `Status`, not older than this call; else the reason."""
        try:
            with self._observer() as client:
                client.timeout = SOON
                status: Mapping[str, Any] = client.call("GetStatus")["status"]
        except ClientError as error:
            return str(error)
        return status

    def _set_mode_by_name(self, mode: str) -> tuple[bool, str]:
        return self.set_mode(mode) if mode else (False, "malformed: a String that names a mode is expected")

    def _e_stop_by_topic(self, level: str, _: str) -> None:
        self._log_outcome(E_STOP, level, self.e_stop(level))

    def _call(self, connect: Ask, method: str, **parameters: Any) -> tuple[bool, str]:
        """Call on a separate connection, so that no other call is before it."""
        try:
            with connect() as client:
                client.timeout = PATIENCE
                answer = client.call(method, **parameters)
        except ClientError as error:
            return False, str(error)
        except Exception as error:  # noqa: BLE001  the stop thread must survive any defect
            return False, f"{method}: {type(error).__name__}: {error}"
        return True, str(answer.get("mode") or answer.get("state") or "")

    def _log_outcome(self, topic: RosTopic, what: str, outcome: tuple[bool, str]) -> None:
        done, message = outcome
        phase = "done" if done else "refused"
        self._on_result({"topic": topic.name, "asked": what, "phase": phase, "message": message})


def denied(operator: Ask) -> str | None:
    """Return why such a connection cannot command; "": it can. None: no daemon answers."""
    try:
        with operator() as client:
            client.timeout = SOON
            client.call("ReleaseLease")  # it has none: the call only checks the role
    except NoDaemon as error:
        return None if error.absent else str(error)
    except CallError as error:
        return str(error) if error.name == "NotAllowed" else None
    except ClientError:
        return None
    return ""
