"""One robot's uplink while it runs: publications, queries, and the command lease.

Threads: one for each publishing connection of the daemon (`topic_outlets.py`), for each kind of query
(`worker_queue.py`), and for each kind of stop, which waits only for the stop before it (`coalesced_stop.py`).
The threads of the Zenoh engine run no code here that waits.
"""

from __future__ import annotations

import argparse
import json
import threading
import time
from collections.abc import Callable
from functools import partial

import zenoh
from msgspec import convert

from twind.bridge.motion_session import MotionSession
from twind.bridge.uplink.coalesced_stop import CoalescedStop
from twind.bridge.uplink.lease_keeper import PERIOD, LeaseKeeper
from twind.bridge.uplink.name_claim import NameClaim
from twind.bridge.uplink.query_server import JSON, QueryServer, RemoteQuery, Serve, Take, encoded
from twind.bridge.uplink.remote_contract import GoalQuery, LeaseQuery
from twind.bridge.uplink.remote_lease import RemoteLease
from twind.bridge.uplink.topic_outlets import MonitorRelay
from twind.bridge.uplink.uplink_goals import PlannedDurations
from twind.bridge.uplink.worker_queue import WorkerQueue
from twind.bridge.zenoh.zenoh_keys import ASKED, RATES, TOPICS, robot_key, robot_name
from twind.client import Client, ClientError, NoDaemon
from twind.client.monitor_stream import RepeatedFaultFilter
from twind.command_line.verb import connected, observer, operator

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
Tell = Callable[[str], None]


class RobotUplink:
    """Uplink of one robot under one name, which it claims until `close`."""

    def __init__(
        self,
        options: argparse.Namespace,
        session: zenoh.Session,
        robot: str,
        tell: Tell,
    ) -> None:
        """Make the uplink. Raises Rejected: the name is taken."""
        self._options = options
        self._session = session
        self.robot = robot
        self._tell = tell
        self._trouble = RepeatedFaultFilter()
        self._limits = RepeatedFaultFilter()
        self._renamed = False
        self._plans = PlannedDurations()
        self._lease = RemoteLease()
        self._driving = MotionSession(partial(operator, options))
        self._lease_keeper = LeaseKeeper(self._driving, self._lease, self._plans, self._publish, tell)
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
        return {queue.name: {"answered": queue.done, "refused": queue.full} for queue in self._queues}

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
        why = ""
        try:
            with operator(self._options) as client:
                client.connect()
        except NoDaemon as error:
            why = "" if error.absent else str(error)
        if self._limits.is_transition(why, time.monotonic()):
            self._tell(f"{why}; so no remote client can command" if why else "commands are taken again")

    def _on_end(self, why: str) -> None:
        if why and self._trouble.is_transition(why, time.monotonic()):
            self._tell(f"{why}; waiting for the daemon")

    def _on_message(self, topic: str, data: bytes) -> None:
        if topic in ("events", "status"):
            self._lease_keeper.on_monitor_reply(json.loads(data)["parameters"])
        elif topic == "trajectories":
            self._plans.on_monitor_reply(json.loads(data)["parameters"])

    # ------------------------------------------------------------------------------------------ answering

    def _open_queues(self) -> list[WorkerQueue | CoalescedStop]:
        door = self._door
        # A settling may last, and a cut must not wait for it.
        stops = [
            CoalescedStop(name, partial(self._stopped, "EStop", SLOW)) for name in ("settling", "cutting")
        ]
        cancelling = CoalescedStop("cancelling", partial(self._stopped, "Cancel", PATIENCE))
        asking = WorkerQueue("asking")
        checking = WorkerQueue("checking", length=LARGE_WAITING, pace=CHECK_PERIOD)
        goals = WorkerQueue(
            "goals",
            length=LARGE_WAITING,
            tend=self._lease_keeper.renew_and_report,
            period=PERIOD,
            last=self._lease_keeper.close,
        )

        def goal(one: RemoteQuery) -> bool:
            came = time.monotonic()
            return goals.put(
                lambda: one.answer(lambda asked: self._lease_keeper.goal(convert(asked, GoalQuery), came))
            )

        def lease(one: RemoteQuery) -> bool:
            if one.asked["op"] == "renew":  # needs no reply of the daemon, so it does not wait
                one.answer(lambda asked: self._lease_keeper.renew(convert(asked, LeaseQuery)))
                return True
            return goals.put(
                lambda: one.answer(lambda asked: self._lease_keeper.lease(convert(asked, LeaseQuery)))
            )

        door.open("EStop", lambda one: stops[one.asked.get("level") == "cut"].put(one), "stop", "EStop")
        door.open("Cancel", cancelling.put, "stop", "Cancel")
        door.open("Lease", lease, "lease")
        door.open("Goal", goal, "goal")
        door.open("Check", _within(checking, partial(self._relayed, "Check", SLOW)), "check")
        for method in ASKED:
            door.open(method, _within(asking, partial(self._relayed, method, PATIENCE)), "ask", method)
        return [
            *stops,
            cancelling,
            asking,
            checking,
            goals,
            WorkerQueue("watching", tend=self._lease_keeper.watch, period=PERIOD),
        ]

    def _relayed(self, method: str, patience: float, parameters: dict[str, object]) -> dict[str, object]:
        """Return the daemon's answer. Raises ClientError."""
        names = ("control",) if method in ("Check", "Cancel") else ("observe", "control")
        with connected(self._options, *names) as client:
            client.timeout = patience
            return client.call(method, **parameters)

    def _stopped(self, method: str, patience: float, parameters: dict[str, object]) -> dict[str, object]:
        """Relay a stop: no goal that arrived here before its answer begins after it. Raises ClientError."""
        self._lease_keeper.stopped(time.monotonic())
        try:
            return self._relayed(method, patience, parameters)
        finally:
            self._lease_keeper.stopped(time.monotonic())

    def _publish(self, goal: str, answer: dict[str, object]) -> None:
        self._session.put(
            robot_key(self.robot, "goals", goal),
            encoded(answer),
            encoding=JSON,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.INTERACTIVE_HIGH,
            express=True,
        )


def _within(queue: WorkerQueue, serve: Serve) -> Take:
    """Return a taker that answers each query in its turn."""
    return lambda one: queue.put(lambda: one.answer(serve))


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
