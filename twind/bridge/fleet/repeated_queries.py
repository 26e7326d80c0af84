"""Queries that a client repeats: a stop until it is done, renewals of a lease, the state of a goal.

Each is repeated by `poll` alone, so only while the caller waits for its answer: a client that hangs renews
nothing, and the robot holds.
"""

from __future__ import annotations

import json
import time
import uuid
from collections.abc import Mapping
from typing import Any

from twind.bridge.commands.motion_end import ENDS
from twind.bridge.fleet.client_reply_queue import ClientReplyQueue
from twind.bridge.fleet.zenoh_robot_queries import RemoteRobotEndpoint, decoded, error_name
from twind.bridge.zenoh.zenoh_keys import LEASE_S

STOP_AGAIN = 0.1  # s from a stop without success to the next: a lost message must not leave the robot moving
LASTING = 3.0  # s for which a stop is repeated
FINAL = ("", "NotAllowed", "InvalidParameter")  # success, and errors that a repetition cannot change
RENEWED = 0.3 * LEASE_S  # s between two renewals; each is sent whether the one before was answered or not
REPORTS = 0.2  # s between two queries of a goal's state
GONE = 3.0  # s without any answer after which the robot counts as lost
JUDGED = 20.0  # s that the check of a goal may take; meanwhile answers to renewals show the robot's presence


class RemoteStop:
    """Remote stop: sent whether the robot was seen or not. A robot that receives it twice stops once."""

    def __init__(
        self, endpoint: RemoteRobotEndpoint, method: str, given: Mapping[str, Any], replies: ClientReplyQueue
    ) -> None:
        """Send the stop; `replies` gets its answer."""
        self._endpoint = endpoint
        self._replies = replies
        self._parts = ("stop", method)
        self._parameters = given
        self._end = time.monotonic() + LASTING
        self._refusal = b""  # the last error that a repetition may change
        self.over = False
        self._ask()

    def poll(self, now: float) -> float:
        """Repeat a stop that was not done; return the time (s) to the next poll."""
        if not self._open and now <= self._end:
            self._ask()
        elif not self._open:
            self.over = True
            if self._refusal:
                self._replies.answer(self._refusal)
            else:
                self._replies.end(self._endpoint.silence(self._parts))
        return STOP_AGAIN

    def _ask(self) -> None:
        self._open = True
        # By each uplink of the name: a false one cannot hide the robot.
        ask = self._endpoint.ask
        ask(self._parts, self._parameters, LASTING, self._answered, self._unanswered, all_robots=True)

    def _answered(self, message: bytes) -> None:
        """Process an answer of any uplink: the first success counts, and no error before it."""
        if self.over:
            return
        if error_name(message) in FINAL:
            self.over = True
            self._replies.answer(message)
        else:
            self._refusal = message
            self._open = False

    def _unanswered(self) -> None:
        self._open = False


class HeldLease:
    """Lease by its Grant. `lost`: it has ended. `confirmed`: s, monotonic, last confirmation."""

    def __init__(self, endpoint: RemoteRobotEndpoint, grant: Mapping[str, Any]) -> None:
        """Begin with a grant that has just arrived."""
        self._endpoint = endpoint
        self.id = str(grant["lease"])
        self._robot_time = float(grant["now"])
        self._came = self.confirmed = time.monotonic()
        self._due = self._came + RENEWED
        self.lost = False

    def deadline(self, now: float) -> float:
        """Return the end of a lease renewed now, s of the robot's clock.

        Early by the way of the grant, never late.
        """
        return self._robot_time + (now - self._came) + LEASE_S

    def query(self, op: str) -> Mapping[str, Any]:
        """Parameters of a query with this lease."""
        return {"op": op, "lease": self.id}

    def renew_if_due(self, now: float) -> float:
        """Renew it when it is due; s until it is due again."""
        if now >= self._due and not self.lost:
            self._due = now + RENEWED
            self._endpoint.ask(("lease",), self.query("renew"), 5.0 * LEASE_S, self._renewed, lambda: None)
        return max(0.0, self._due - now)

    def _renewed(self, message: bytes) -> None:
        """Process an answer. A busy robot may renew at the next request; a refusal ends the lease."""
        name = error_name(message)
        if name == "":
            self.confirmed = time.monotonic()
        self.lost = self.lost or name == "Refused"


class SentGoal:
    """One trajectory, submitted once, whose state is queried to its end.

    Its reports are answers of SubmitTrajectory with `more`. A repeated query with its name and lease never
    runs it twice: the answer is the state of the first.
    """

    def __init__(
        self,
        endpoint: RemoteRobotEndpoint,
        lease: HeldLease,
        path: Mapping[str, Any],
        replies: ClientReplyQueue,
    ) -> None:
        """Send the goal. `path`: a Trajectory."""
        self._endpoint = endpoint
        self._lease = lease
        self._replies = replies
        now = time.monotonic()
        self.over = False
        self._again = self._judged = False  # queried again; accepted by the gate
        self._last: Mapping[str, Any] = {}
        self._queried_at = self._alive = now
        self._named = {"goal": uuid.uuid4().hex, "lease": lease.id}
        self._ask(self._named | {"deadline": lease.deadline(now), "trajectory": path}, JUDGED)

    def poll(self, now: float) -> float:
        """Renew the lease and query the goal; return the s until the next call."""
        if now - max(self._alive, self._lease.confirmed) > GONE:
            robot = self._endpoint.robot
            lost = f"{robot}: no answer for {GONE:g} s; the lease has lapsed, so its motion is held"
            self._replies.end(lost)
        elif not self._open and now - self._queried_at >= REPORTS:
            self._queried_at = now
            self._again = True
            self._ask(self._named, GONE)
        return min(self._lease.renew_if_due(now), REPORTS)

    def _ask(self, what: Mapping[str, Any], patience: float) -> None:
        """Send one query at a time: while the gate judges, repeats would fill the robot's queue of goals."""
        self._open = True
        self._endpoint.ask(("goal",), what, patience, self._answered, self._unanswered)

    def _unanswered(self) -> None:
        self._open = False

    def _answered(self, message: bytes) -> None:
        """Deliver an error that ends the goal, and each state once."""
        self._open = False
        name = error_name(message)
        report = decoded(message).get("parameters")
        if name or not isinstance(report, dict) or not report.get("phase"):
            ends = name == "Refused" if self._judged else not self._again or name != "Busy"
            if ends:  # a busy answer to a repeated query is no end
                self._end(message)
            return
        self._alive = time.monotonic()
        self._judged = True
        report.setdefault("progress", 0.0)
        if self.over or report == self._last:
            return
        self._last = report
        if report["phase"] in ENDS:
            self._end(json.dumps({"parameters": report}).encode())
        else:
            self._replies.answer(json.dumps({"parameters": report, "continues": True}).encode())

    def _end(self, message: bytes) -> None:
        if not self.over:
            self.over = True
            self._replies.answer(message)
