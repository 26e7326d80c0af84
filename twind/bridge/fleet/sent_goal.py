"""Goal of a remote robot: one trajectory, submitted once, then followed; queried where no report comes."""

import json
import threading
import uuid
from collections.abc import Mapping
from typing import Any

from twind.bridge.fleet.client_reply_queue import ClientReplyQueue
from twind.bridge.fleet.lease_renewer import LeaseRenewer
from twind.bridge.fleet.robot_endpoint import RemoteRobotEndpoint, error_name
from twind.bridge.motion_session import ENDS

QUIET = 1.0  # s without a report after which the goal is queried: a lost message must not hide its end
GONE = 3.0  # s without any answer after which the robot counts as lost
JUDGED = 20.0  # s that the check of a goal may take; meanwhile answers to renewals show the robot's presence
LONGEST = 64 << 10  # bytes of a report; none that is longer comes from an uplink
EARLY = 32  # reports that may come before the answer to the goal


class SentGoal:
    """One goal under way. Its answers go into the inbox in the form of SubmitTrajectory with `more`."""

    def __init__(
        self,
        reach: RemoteRobotEndpoint,
        hold: LeaseRenewer,
        path: Mapping[str, Any],
        inbox: ClientReplyQueue,
        now: float,
    ) -> None:
        """Send the goal. `path`: a Trajectory; `now`: s, monotonic."""
        self._reach = reach
        self._hold = hold
        self._inbox = inbox
        self._lock = threading.Lock()
        self.over = self._closed = False
        self._open = self._again = False  # a query is under way; it is a repeated one
        self._answered = False  # by the gate
        self._early: list[dict[str, object]] = []  # reports before the gate's answer
        self._last: dict[str, object] = {}
        self._reported = False  # a report since the last poll
        self._queried_at = now
        self._alive = now
        name = uuid.uuid4().hex
        # A repeated query with its name and lease never runs it twice: the answer is the state of the first.
        self._named = {"goal": name, "lease": hold.id}
        whole = self._named | {"deadline": hold.deadline(now), "trajectory": path}
        self._subscription = reach.subscribe_news(("goals", name), self._progress)
        self._ask(whole, JUDGED)

    def close(self) -> None:
        """Stop receiving reports of the goal. May be called twice."""
        if not self._closed:
            self._closed = True
            self._subscription.undeclare()

    def poll(self, now: float) -> float:
        """Renew the lease and query a goal of which no report comes; return the s until the next call."""
        if self._reported:
            self._reported = False
            self._alive = now
            self._queried_at = max(self._queried_at, now)
        self._alive = max(self._alive, self._hold.confirmed)
        if now - self._alive > GONE:
            self._inbox.end(
                f"{self._reach.robot}: no answer for {GONE:g} s; the lease has lapsed, so its motion is held"
            )
        elif now - self._queried_at > QUIET and not self._open:
            self._queried_at = now
            self._again = True
            self._ask(self._named, GONE)
        return min(self._hold.renew_if_due(now), QUIET)

    def _ask(self, what: Mapping[str, Any], patience: float) -> None:
        """Send one query at a time: while the gate judges, repeats would fill the robot's queue of goals."""
        self._open = True
        self._reach.ask(("goal",), what, patience, self._answer, self._on_silence)

    def _on_silence(self) -> None:
        self._open = False

    def _answer(self, message: bytes) -> None:
        """Process an answer of the gate to the goal, or of the uplink to a repeated query."""
        self._open = False
        report = _parameters(message)
        with self._lock:
            if report is None and self._again and not self._ends(message):
                return  # a busy answer to a repeated query: that is no end
            self._reported = True
            if report is None:
                self._end(message)
            elif not self._answered:
                self._answered = True
                for each in [report, *self._early]:
                    self._deliver_reply(each)
            else:
                self._deliver_reply(report)

    def _ends(self, error: bytes) -> bool:
        """True if this error ends the goal: of an accepted goal "Refused" alone, else all but "Busy"."""
        name = error_name(error)
        return name == "Refused" if self._answered else name != "Busy"

    def _progress(self, payload: bytes) -> None:
        if len(payload) > LONGEST:
            return
        report = _parameters(b'{"parameters":%b}' % payload)
        with self._lock:
            self._reported = True
            if report is None:
                return
            if self._answered:
                self._deliver_reply(report)
            elif len(self._early) < EARLY:
                self._early.append(report)

    def _deliver_reply(self, report: dict[str, object]) -> None:
        """Put a report into the inbox once: answers to queries and published reports overlap."""
        if self.over or report == self._last or (report["phase"] == "accepted" and self._last):
            return
        self._last = report
        ended = report["phase"] in ENDS
        message = json.dumps({"parameters": report} | ({} if ended else {"continues": True})).encode()
        if ended:
            self._end(message)
        else:
            self._inbox.answer(message)

    def _end(self, message: bytes) -> None:
        if not self.over:
            self.over = True
            self._inbox.answer(message)


def _parameters(message: bytes) -> dict[str, object] | None:
    """Return the reported state of a goal from a message; None: an error, or no valid message."""
    try:
        report: dict[str, object] = json.loads(message)["parameters"]
        report.setdefault("progress", 0.0)
        return report if report["phase"] else None
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None
