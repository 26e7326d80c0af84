"""One robot's uplink while it runs: publications, queries, and the command lease.

Threads: one for each publishing connection of the daemon (`topic_outlets.py`), and for each kind of query and
of stop (`twind.bridge.commands`). The threads of the Zenoh engine run no code here that waits.
"""

from __future__ import annotations

import argparse
import json
import threading
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import zenoh
from msgspec import convert

from twind.bridge.commands.control_socket_access import denied
from twind.bridge.commands.leased_motions import LeasedMotions
from twind.bridge.commands.request_queue import LONG, PACE, RequestQueue
from twind.bridge.commands.stop_queues import CUT, HOLD, SETTLE, StopQueues, Tell
from twind.bridge.uplink.name_claim import NameClaim
from twind.bridge.uplink.query_server import JSON, QueryServer, RemoteQuery, Serve, Take, encoded
from twind.bridge.uplink.remote_contract import GoalQuery, LeaseQuery
from twind.bridge.uplink.remote_goals import PERIOD, RemoteGoals
from twind.bridge.uplink.topic_outlets import MonitorRelay
from twind.bridge.zenoh.zenoh_keys import ASKED, RATES, TOPICS, robot_key, robot_name
from twind.client import Client, ClientError
from twind.client.monitor_stream import RepeatedFaultFilter
from twind.command_line.verb import observer, operator

FASTEST = 1000.0  # Hz: the daemon gives at most the loop's rate
ON_DEMAND = "latency"  # read only with subscribers; all other topics are always read
CHECK_PERIOD = 0.2  # s between two checks: the daemon counts them with the goals, all for this connection
LARGE_WAITING = 8  # questions with a trajectory that may wait: up to 4 MB each
# s for an answer of the daemon; for a stop, or a check while the model loads. A shorter wait would report a
# settling that is under way as failed.
PATIENCE = 5.0
SLOW = 35.0
AGAIN = 0.5  # s between two attempts to reach it: without a pause a refused connect would fill a core
END = 1.0  # s at the end for what is under way


class RobotUplink:
    """Uplink of one robot under one name, which it claims until `close`."""

    def __init__(self, options: argparse.Namespace, session: zenoh.Session, robot: str, tell: Tell) -> None:
        """Make the uplink. Raises Rejected: the name is taken."""
        self._options = options
        self._session = session
        self.robot = robot
        self._tell = tell
        self._trouble = RepeatedFaultFilter()
        self._limits = RepeatedFaultFilter()
        self._renamed = False
        motions = LeasedMotions(partial(operator, options))
        self._goals = RemoteGoals(motions, self._publish, tell)
        self._stops = StopQueues(
            partial(operator, options), partial(observer, options), motions.stopped, tell
        )
        self._presence = NameClaim(session, robot)
        self._relays = self._make_relays()
        self._door = QueryServer(session, robot, tell)
        self._queues = self._open_queues()

    def start(self) -> None:
        """Start to publish and to answer."""
        for relay in self._relays:
            relay.start()
        for queue in self._queues:
            queue.start()
        self._presence.claim()

    @property
    def rival(self) -> str:
        """Return why another uplink has the name now; "": this one has it."""
        return self._presence.rival

    def is_over(self, now: float) -> bool:
        """True if this name is over: the daemon has another robot now, or another uplink has the name."""
        self._presence.look(now)
        return self._renamed or bool(self.rival)

    def close(self) -> None:
        """Release the robot, then the name. Takes slightly longer than END."""
        self._door.close()
        for relay in self._relays:
            relay.stop()
        deadline = time.monotonic() + END
        for queue in self._queues:
            queue.stop(max(0.0, deadline - time.monotonic()))
        for relay in self._relays:
            relay.join(max(0.0, deadline - time.monotonic()))
        self._presence.close()

    def tally(self) -> dict[str, dict[str, int]]:
        """Counts of answered queries, and of those that found no room, by queue."""
        return {queue.name: {"answered": queue.answered, "refused": queue.refused} for queue in self._queues}

    # ------------------------------------------------------------------------------------------ telling

    def _make_relays(self) -> list[MonitorRelay]:
        connect = partial(observer, self._options)
        rare = [topic for topic in TOPICS if topic != ON_DEMAND]
        news = MonitorRelay(
            connect, rare, None, always=True, began=self._began, take=self._on_message, ended=self._on_end
        )
        often = MonitorRelay(connect, [ON_DEMAND], None)
        for topic in TOPICS:
            (often if topic == ON_DEMAND else news).lead(self._session, self.robot, topic, "news", topic)
        states = []
        for rate in RATES:
            state = MonitorRelay(connect, ["state"], FASTEST if rate == "full" else float(rate))
            state.lead(self._session, self.robot, "state", "state", rate)
            states.append(state)
        return [news, often, *states]

    def _began(self, client: Client) -> None:
        """Handle the start of a daemon: check that it is the same robot's."""
        name = self._options.name or reported_name(client)
        if name != self.robot:
            self._tell(f"the daemon's robot is {name} now, no longer {self.robot}")
            self._renamed = True
        elif self._trouble.is_transition("", time.monotonic()):
            self._tell("the daemon is there again")
        self._report_permission()

    def _report_permission(self) -> None:
        """Check whether control.sock can be opened, and report changes.

        Without permission for it the uplink only observes: the robot can only be watched and stopped.
        """
        why = denied(partial(operator, self._options)) or ""
        if self._limits.is_transition(why, time.monotonic()):
            self._tell(f"{why}; so no remote client can command" if why else "commands are taken again")

    def _on_end(self, why: str) -> None:
        if why and self._trouble.is_transition(why, time.monotonic()):
            self._tell(f"{why}; waiting for the daemon")

    def _on_message(self, topic: str, data: bytes) -> None:
        if topic in ("events", "status", "trajectories"):
            self._goals.on_monitor_reply(json.loads(data)["parameters"])

    # ------------------------------------------------------------------------------------------ answering

    def _open_queues(self) -> list[RequestQueue[Any]]:
        """Accept queries; return the queues that answer them."""
        goals = self._queue("goals", LARGE_WAITING, tend=self._goals.keep, last=self._goals.close)
        asking = self._queue("asking")
        checking = self._queue("checking", LARGE_WAITING, CHECK_PERIOD)

        def goal(one: RemoteQuery) -> bool:
            came = time.monotonic()
            return _put(goals, one, lambda asked: self._goals.goal(convert(asked, GoalQuery), came))

        def lease(one: RemoteQuery) -> bool:
            if one.parameters["op"] != "renew":
                return _put(goals, one, lambda asked: self._goals.lease(convert(asked, LeaseQuery)))
            one.answer(lambda asked: self._goals.renew(convert(asked, LeaseQuery)))  # waits for nothing
            return True

        door = self._door
        door.open("EStop", lambda one: self._stop(CUT if _cuts(one) else SETTLE, one), "stop", "EStop")
        door.open("Cancel", partial(self._stop, HOLD), "stop", "Cancel")
        door.open("Lease", lease, "lease")
        door.open("Goal", goal, "goal")
        door.open("Check", _in_queue(checking, partial(self._relayed, "control", "Check", SLOW)), "check")
        for method in ASKED:
            serve = partial(self._relayed, "observe", method, PATIENCE)
            door.open(method, _in_queue(asking, serve), "ask", method)
        watching = self._queue("watching", tend=self._goals.watch)
        return [*self._stops.queues.values(), asking, checking, goals, watching]

    def _queue(
        self,
        name: str,
        length: int = LONG,
        pace: float = PACE,
        *,
        tend: Callable[[], None] | None = None,
        last: Callable[[], None] | None = None,
    ) -> RequestQueue[Callable[[], None]]:
        """Return a queue of calls."""
        period = None if tend is None else PERIOD
        tell = self._tell
        return RequestQueue(name, _call, tell, length=length, pace=pace, tend=tend, period=period, last=last)

    def _stop(self, kind: str, one: RemoteQuery) -> bool:
        if not self._stops.put(kind, one):
            one.forget()
        return True

    def _relayed(self, socket: str, method: str, patience: float, given: dict[str, Any]) -> dict[str, Any]:
        """Return the daemon's answer. Raises ClientError."""
        with operator(self._options) if socket == "control" else observer(self._options) as client:
            client.timeout = patience
            return client.call(method, **given)

    def _publish(self, goal: str, answer: dict[str, object]) -> None:
        self._session.put(
            robot_key(self.robot, "goals", goal),
            encoded(answer),
            encoding=JSON,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.INTERACTIVE_HIGH,
            express=True,
        )


def _cuts(one: RemoteQuery) -> bool:
    return one.parameters.get("level") == CUT


def _call(calls: Sequence[Callable[[], None]]) -> None:
    for call in calls:
        call()


def _put(queue: RequestQueue[Callable[[], None]], one: RemoteQuery, serve: Serve) -> bool:
    return queue.put(lambda: one.answer(serve)) is not None


def _in_queue(queue: RequestQueue[Callable[[], None]], serve: Serve) -> Take:
    """Return a taker that answers each query in its turn."""
    return lambda one: _put(queue, one, serve)


def reported_name(client: Client) -> str:
    """Return the name of the daemon's robot. Raises ClientError."""
    status = client.call("GetStatus")["status"]
    return robot_name(status, client.call("GetParameters")["parameters"])


def awaited_name(options: argparse.Namespace, stop: threading.Event, tell: Tell) -> str:
    """Wait for a daemon, and return the name that it reports; "": a stop signal came first."""
    trouble = RepeatedFaultFilter()
    while not stop.is_set():
        try:
            with observer(options) as client:
                client.timeout = PATIENCE
                return reported_name(client)
        except ClientError as error:
            if trouble.is_transition(str(error), time.monotonic()):
                tell(f"{error}; waiting for the daemon")
        stop.wait(AGAIN)
    return ""
