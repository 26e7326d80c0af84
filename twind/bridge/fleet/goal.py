"""One trajectory sent from afar: asked for once, then followed; where nothing is told, asked after."""

import json
import threading
import uuid
from collections.abc import Mapping
from typing import Any

from twind.bridge.fleet.hold import Hold
from twind.bridge.fleet.inbox import Inbox
from twind.bridge.fleet.reach import Reach

ENDS = ("succeeded", "cancelled", "replaced", "aborted")
QUIET = 1.0  # s without a word after which it is asked what became of the goal
GONE = 3.0  # s without any answer after which the robot counts as lost


class Goal:
    """Its answers go into the inbox as those of SubmitTrajectory with `more` do."""

    def __init__(self, reach: Reach, hold: Hold, path: Mapping[str, Any], inbox: Inbox, now: float) -> None:
        """Sends it. `path`: a Trajectory; `now`: s, monotonic."""
        self._reach, self._hold, self._inbox = reach, hold, inbox
        self._lock = threading.Lock()
        self.over = self._closed = False
        self._answered = False  # by the gate
        self._early: list[dict[str, Any]] = []  # told before the gate's answer was here
        self._last: dict[str, Any] = {}
        self._heard = False  # since the last look
        self._asked, self._alive = now, now
        name = uuid.uuid4().hex
        # The same question again is never run twice: its answer is what became of the first.
        self._question = {
            "goal": name,
            "lease": hold.id,
            "deadline": hold.deadline(now),
            "trajectory": path,
        }
        self._told = reach.hear(("goals", name), self._progress)
        self._ask()

    def close(self) -> None:
        """Hear no more of it. May be called twice."""
        if not self._closed:
            self._closed = True
            self._told.undeclare()

    def tend(self, now: float) -> float:
        """Renew the lease, ask after a goal of which nothing is heard; s until it is to be done again."""
        if self._heard:
            self._heard, self._alive, self._asked = False, now, max(self._asked, now)
        self._alive = max(self._alive, self._hold.confirmed)
        if now - self._alive > GONE:
            self._inbox.end(
                f"{self._reach.robot}: no answer for {GONE:g} s; the lease has lapsed, so its motion is held"
            )
        elif now - self._asked > QUIET:
            self._asked = now
            self._ask()
        return min(self._hold.tend(now), QUIET)

    def _ask(self) -> None:
        self._reach.ask(("goal",), self._question, GONE, self._answer, lambda: None)

    def _answer(self, message: bytes) -> None:
        """Of the gate, or of the uplink that was asked again."""
        told = _parameters(message)
        with self._lock:
            if told is None and self._answered and b"Control.Refused" not in message:
                return  # asked after, and too busy to say: that is no end
            self._heard = True
            if told is None:
                self._end(message)
            elif not self._answered:
                self._answered = True
                for each in [told, *self._early]:
                    self._tell(each)
            else:
                self._tell(told)

    def _progress(self, payload: bytes) -> None:
        told = _parameters(b'{"parameters":%b}' % payload)
        with self._lock:
            self._heard = True
            if told is None:
                return
            if self._answered:
                self._tell(told)
            else:
                self._early.append(told)

    def _tell(self, told: dict[str, Any]) -> None:
        """Once each: what is answered and what is told overlap."""
        if self.over or told == self._last or (told["phase"] == "accepted" and self._last):
            return
        self._last = told
        ended = told["phase"] in ENDS
        message = json.dumps({"parameters": told} | ({} if ended else {"continues": True})).encode()
        if ended:
            self._end(message)
        else:
            self._inbox.answer(message)

    def _end(self, message: bytes) -> None:
        if not self.over:
            self.over = True
            self._inbox.answer(message)


def _parameters(message: bytes) -> dict[str, Any] | None:
    """What is told of a goal; None: an error, or no message."""
    try:
        told: dict[str, Any] = json.loads(message)["parameters"]
        told.setdefault("progress", 0.0)
        return told if told["phase"] else None
    except (ValueError, KeyError, TypeError, AttributeError):
        return None
