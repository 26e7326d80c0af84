"""Stops, modes and questions from ROS: each a call of the daemon. Standard library, Python 3.10.

A stop waits for nobody: neither for a change of the mode nor for a trajectory that is being judged.
Arming is not among them. Whoever arms stands beside the robot.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from twind.bridge.ros.endpoints import (
    E_STOP,
    GET_STATUS,
    SET_LIVE,
    SET_MODE,
    STOP,
    TO_E_STOP,
    TO_MODE,
    TO_STOP,
    Service,
    Topic,
)
from twind.bridge.ros.inbox import Told
from twind.client import Client, ClientError
from twind.ros import STRING, CdrError, decode

PATIENCE = 35.0  # s for an answer; an e-stop answers when its first effect is confirmed, within 30
LEVELS = ("settle", "cut")
REASON = "asked for over ROS"

KEPT = 2  # different things asked of one errand that wait: both levels of an e-stop, the last two modes

Ask = Callable[[], Client]


class Errand:
    """Does what was asked for, the newest last, in a thread of its own. The same twice is once."""

    def __init__(self, name: str, do: Callable[[str], None]) -> None:
        self._do, self._asked = do, threading.Condition()
        self._what: list[str] = []
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
            self._do(what)


class Calls:
    """`heard` and `asked` may be called from any thread; `heard` returns at once."""

    def __init__(
        self, operator: Ask, observer: Ask, stopping: Callable[[], None], status: Callable[[], str], say: Told
    ) -> None:
        """`operator`, `observer` make connections; `stopping` is told of a stop before it is asked for.

        `status`: the text of the topic /bridge/status. `say` gets what became of what came by topic.
        """
        self._operator, self._observer, self._stopping = operator, observer, stopping
        self._status, self._say = status, say
        self._errands = {
            STOP.name: Errand("stop", lambda _: self._tell(STOP, "", self.stop())),
            E_STOP.name: Errand("e-stop", lambda level: self._tell(E_STOP, level, self.e_stop(level))),
            SET_MODE.name: Errand("mode", lambda mode: self._tell(SET_MODE, mode, self.set_mode(mode))),
        }

    def start(self) -> None:
        """Begin to do what topics ask for."""
        for errand in self._errands.values():
            errand.start()

    def heard(self, topic: Topic, data: bytes) -> None:
        """A message of one of our topics. One that makes no sense changes no mode, but a stop is a stop."""
        try:
            text = str(decode(STRING, data)["data"]).strip()
        except CdrError as error:
            if topic is SET_MODE:
                self._tell(topic, "", (False, f"malformed: {error}"))
                return
            text = ""
        if topic is E_STOP and text not in LEVELS:
            text = LEVELS[0]
        self._errands[topic.name].ask("" if topic is STOP else text[:80])

    def asked(self, service: Service, data: bool | None) -> tuple[bool, str]:
        """A request of one of our services: success, and words. Waits for the daemon."""
        if service is GET_STATUS:
            return True, self._status()
        if service is TO_STOP:
            return self.stop()
        if service is TO_E_STOP:
            return self.e_stop(LEVELS[0])
        if service is SET_LIVE:
            return self.set_mode("live" if data else "mirror")
        return self.set_mode(next(mode for mode, known in TO_MODE.items() if known is service))

    def stop(self) -> tuple[bool, str]:
        """Decelerate and hold."""
        self._stopping()
        return self._call(self._operator, "Cancel")

    def e_stop(self, level: str) -> tuple[bool, str]:
        """Stop now. It latches: who acknowledges it (`twindctl reset`) stands beside the robot."""
        self._stopping()
        return self._call(self._observer, "EStop", level=level, reason=REASON)

    def set_mode(self, mode: str) -> tuple[bool, str]:
        """Where commands go: sim, mirror, live. It does not arm."""
        return self._call(self._operator, "SetMode", mode=mode)

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

    def _tell(self, topic: Topic, what: str, outcome: tuple[bool, str]) -> None:
        done, message = outcome
        phase = "done" if done else "refused"
        self._say({"topic": topic.name, "asked": what, "phase": phase, "message": message})
