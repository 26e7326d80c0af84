"""Stops, modes and questions from ROS: each a call of the daemon. Standard library, Python 3.10.

A stop waits for nobody: neither for a change of the mode nor for a trajectory that is being judged.
Arming is not among them. Whoever arms stands beside the robot.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from twind.bridge.ros.ros_command_queue import Told
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
REASON = "asked for over ROS"

KEPT = 2  # different things asked of one errand that wait
# s from one to the next; an e-stop has none
MODE_PACE = 1.0
STOP_PACE = 0.1

Ask = Callable[[], Client]
STOPPING = "stopping: the robot decelerates and holds"


class CoalescedCall:
    """Does what was asked for, the newest last, in a thread of its own. The same twice is once."""

    def __init__(
        self, name: str, do: Callable[[str], None], tell: Callable[[str], None], pace: float = 0.0
    ) -> None:
        """`tell` gets a line when `do` raised. `pace`: s between two."""
        self._do = do
        self._tell = tell
        self._pace = pace
        self._what: list[str] = []
        self._asked = threading.Condition()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def ask(self, what: str) -> None:
        """Returns at once."""
        with self._asked:
            self._what = [*(each for each in self._what if each != what), what][-KEPT:]
            self._asked.notify()

    def _run(self) -> None:
        while True:
            with self._asked:
                self._asked.wait_for(lambda: self._what)
                what = self._what.pop(0)
            try:
                self._do(what)
            except Exception as error:  # noqa: BLE001  the next stop is done all the same
                with suppress(Exception):
                    self._tell(f"{self._thread.name}: {type(error).__name__}: {error}")
            time.sleep(self._pace)


class RosServiceCalls:
    """`heard` and `asked` may be called from any thread; `heard` returns at once."""

    def __init__(
        self,
        operator: Ask,
        observer: Ask,
        stopping: Callable[[], None],
        status: Callable[[Mapping[str, Any] | str], str],
        closed: Callable[[bool], str],
        say: Told,
        tell: Callable[[str], None],
    ) -> None:
        """`operator`, `observer` make connections; `stopping` is told of a stop before it is asked for.

        `status`: the text of /bridge/status by what the daemon says now, or by why it does not. `closed`: why
        no stop (True), or no mode is taken; "": it is. `say` gets what became of what came by topic, `tell` a
        line where even that fails.
        """
        self._operator = operator
        self._observer = observer
        self._stopping = stopping
        self._status = status
        self._closed = closed
        self._say = say
        self._stop = CoalescedCall(
            "stop", lambda _: self._log_outcome(STOP, "", self.stop()), tell, STOP_PACE
        )
        self._mode = CoalescedCall(
            "mode",
            lambda mode: self._log_outcome(SET_MODE, mode, self._set_mode_by_name(mode)),
            tell,
            MODE_PACE,
        )
        # One each: who asks for a cut does so because the robot does not settle.
        self._e_stops = {level: self._e_stop_errand(level, tell) for level in LEVELS}

    def start(self) -> None:
        """Begin to do what topics ask for."""
        for errand in (*self._e_stops.values(), self._stop, self._mode):
            errand.start()

    def on_message(self, topic: RosTopic, data: bytes) -> None:
        """A message of one of our topics. One that makes no sense changes no mode, but a stop is a stop."""
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
        """A request of one of our services: success, and words. Waits for the daemon."""
        if service is GET_STATUS:
            return True, self._status(self._asked_now())
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
        # The state that it answers with says nothing of the motion.
        return done, STOPPING if done else message

    def e_stop(self, level: str) -> tuple[bool, str]:
        """Stop now. It latches: who acknowledges it (`twindctl reset`) stands beside the robot."""
        self._stopping()
        outcome = False, ""
        for connect in (self._observer, self._operator):  # the one may have no place left, or not answer
            outcome = self._call(connect, "EStop", level=level, reason=REASON)
            if outcome[0]:
                break
        return outcome

    def set_mode(self, mode: str) -> tuple[bool, str]:
        """Where commands go: sim, mirror, live. It does not arm."""
        why = self._closed(False)
        return (False, why) if why else self._call(self._operator, "SetMode", mode=mode)

    def _asked_now(self) -> Mapping[str, Any] | str:
        """`Status`, not older than this call; else why not."""
        try:
            with self._observer() as client:
                client.timeout = SOON
                status: Mapping[str, Any] = client.call("GetStatus")["status"]
        except ClientError as error:
            return str(error)
        return status

    def _set_mode_by_name(self, mode: str) -> tuple[bool, str]:
        return self.set_mode(mode) if mode else (False, "malformed: a String that names a mode is expected")

    def _e_stop_errand(self, level: str, tell: Callable[[str], None]) -> CoalescedCall:
        return CoalescedCall(
            f"e-stop {level}", lambda _: self._log_outcome(E_STOP, level, self.e_stop(level)), tell
        )

    def _call(self, connect: Ask, method: str, **parameters: Any) -> tuple[bool, str]:
        """On a connection of its own, so that nothing is before it."""
        try:
            with connect() as client:
                client.timeout = PATIENCE
                answer = client.call(method, **parameters)
        except ClientError as error:
            return False, str(error)
        except Exception as error:  # noqa: BLE001  whoever stops must outlive a fault of ours
            return False, f"{method}: {type(error).__name__}: {error}"
        return True, str(answer.get("mode") or answer.get("state") or "")

    def _log_outcome(self, topic: RosTopic, what: str, outcome: tuple[bool, str]) -> None:
        done, message = outcome
        phase = "done" if done else "refused"
        self._say({"topic": topic.name, "asked": what, "phase": phase, "message": message})


def denied(operator: Ask) -> str | None:
    """Why nobody can be moved by such a connection; "": somebody can. None: no daemon says."""
    try:
        with operator() as client:
            client.timeout = SOON
            client.call("ReleaseLease")  # it has none: nothing happens, but for the role to be looked at
    except NoDaemon as error:
        return None if error.absent else str(error)
    except CallError as error:
        return str(error) if error.name == "NotAllowed" else None
    except ClientError:
        return None
    return ""
