"""A remote robot behind an ordinary `twind.client.Client`: each call becomes a query over Zenoh.

Calls that no uplink carries are refused here, before anything is sent: arming and changing the mode require
presence beside the robot.
"""

from __future__ import annotations

import getpass
import json
import socket
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any

import zenoh

from twind.bridge.fleet.client_reply_queue import ClientReplyQueue
from twind.bridge.fleet.repeated_queries import HeldLease, RemoteStop, SentGoal
from twind.bridge.fleet.topic_rate_limiter import TopicRateLimiter, keys
from twind.bridge.fleet.zenoh_robot_queries import RemoteRobotEndpoint, TakeMessage, decoded, error_name
from twind.bridge.zenoh.zenoh_keys import ASKED, LEASE_S, STOPS, robot_key
from twind.client import Disconnected, NoDaemon, NotCarried

if TYPE_CHECKING:
    from twind.bridge.fleet.client_sessions import PrivateSession, SharedSession

FOUND = 2.0  # s within which a robot that is there is found
IDLE = 5.0  # s between two polls of an idle line
PARTING = 0.5  # s that giving a lease back may take when the line is closed
LEASE = ("lease",)

Parameters = Mapping[str, Any]


class ZenohClientLine:
    """A `twind.client.client_line.ClientLine` to `robot`, its name in the key space.

    Raises ValueError: not a valid name.
    """

    def __init__(self, robot: str, way: PrivateSession | SharedSession) -> None:
        robot_key(robot)
        self.where = f"robot {robot} by {way.where}"
        self._robot = robot
        self._way = way
        self._endpoint: RemoteRobotEndpoint | None = None
        self._replies = ClientReplyQueue()
        self._lease: HeldLease | None = None
        self._there = threading.Event()
        self._repeated: SentGoal | RemoteStop | None = None  # under way
        self._subscribers: list[zenoh.Subscriber[None]] = []

    @property
    def is_open(self) -> bool:
        """True while the network is joined and the line is not closed."""
        return self._endpoint is not None

    def open(self, patience: float) -> None:
        """Join the network. Raises NoDaemon. The first query shows whether the robot is there."""
        if self._endpoint is not None:
            return
        endpoint = RemoteRobotEndpoint(self._way.open_session(patience), self._robot)
        replies = self._replies = ClientReplyQueue()
        self._there = threading.Event()
        gone = f"{self.where}: it went away, or the way to it is lost"
        try:
            self._subscribers = [endpoint.watch(self._there.set, lambda: replies.end(gone))]
        except BaseException:
            self._forget(endpoint)
            raise
        self._endpoint = endpoint

    def close(self) -> None:
        """Close the line. A lease is given back, else it lapses: motion under it ends in a hold."""
        endpoint = self._endpoint
        if endpoint is None:
            return
        self._endpoint = None
        if self._lease is not None and not self._lease.lost:
            released = threading.Event()
            with suppress(Disconnected):
                query = self._lease.query("release")
                endpoint.ask(LEASE, query, PARTING, lambda _: released.set(), released.set)
                released.wait(PARTING)  # else the session may close before the query is sent
        self._forget(endpoint)

    def cut(self) -> None:
        """End the wait for messages in another thread: nothing comes any more."""
        self._replies.end(f"{self.where}: hung up")

    def _forget(self, endpoint: RemoteRobotEndpoint) -> None:
        for each in self._subscribers:
            each.undeclare()
        self._repeated = None
        self._lease = None
        self._subscribers = []
        self._way.release_session(endpoint.session)

    # ------------------------------------------------------------------------------------------ messages

    def send(self, message: bytes, patience: float) -> None:
        """Send a query. Raises NotCarried; NoDaemon: the robot is not there.

        A stop is sent without waiting for the robot to be seen.
        """
        endpoint = self._endpoint
        assert endpoint is not None
        call = json.loads(message)
        method = call["method"].rpartition(".")[2]
        given: Parameters = call["parameters"]
        if method in STOPS:  # the presence token may be late or lost, and the robot would go on moving
            self._repeated = RemoteStop(endpoint, method, given, self._replies)
            return
        carry = self._carrier(endpoint, method, more=bool(call.get("more")))
        if not self._there.wait(min(patience, FOUND)):
            self.close()
            raise NoDaemon(f"{self.where}: not present; `twindctl fleet` lists the robots", absent=True)
        carry(given, patience)

    def receive(self, patience: float) -> bytes:
        """The next message. Raises TimeoutError, Disconnected, NoDaemon."""
        deadline = time.monotonic() + patience
        while (left := deadline - time.monotonic()) > 0.0:
            repeated = self._repeated
            idle = repeated is None or repeated.over
            due = IDLE if repeated is None or idle else repeated.poll(time.monotonic())
            message = self._replies.take(min(left, due))
            if message is not None:
                return self._understood(message)
        raise TimeoutError

    def take_received(self) -> list[bytes]:
        """Return the messages that have come already."""
        return self._replies.rest()

    def _understood(self, message: bytes) -> bytes:
        if message.startswith(b'{"error"') and error_name(message) == "NoDaemon":
            why = decoded(message).get("parameters", {}).get("message", "")
            raise NoDaemon(f"{self.where}: its uplink is there, its daemon is not: {why}")
        return message

    # ------------------------------------------------------------------------------------------ calls

    def _carrier(
        self, endpoint: RemoteRobotEndpoint, method: str, *, more: bool
    ) -> Callable[[Parameters, float], None]:
        """Return the function that makes a call. Raises NotCarried."""
        calls: dict[str, Callable[[Parameters, float], None]] = {
            **{each: partial(self._ask, endpoint, ("ask", each)) for each in ASKED},
            "Check": partial(self._ask, endpoint, ("check",)),
            "AcquireLease": partial(self._acquire, endpoint),
            "RenewLease": partial(self._renew, endpoint),
            "ReleaseLease": partial(self._release, endpoint),
        }
        streams = {
            "Monitor": partial(self._monitor, endpoint),
            "SubmitTrajectory": partial(self._go, endpoint),
        }
        found = calls.get(method) or (streams.get(method) if more else None)
        if found is None:
            here = f"arm {self._robot} and set it up beside the robot"
            raise NotCarried(f"{method}: not for remote clients; {here}")
        return found

    def _ask(
        self,
        endpoint: RemoteRobotEndpoint,
        parts: tuple[str, ...],
        what: Parameters,
        patience: float,
        answered: TakeMessage | None = None,
    ) -> None:
        replies = self._replies
        silence = endpoint.silence(parts)
        endpoint.ask(parts, what, patience, answered or replies.answer, lambda: replies.end(silence))

    def _acquire(self, endpoint: RemoteRobotEndpoint, given: Parameters, patience: float) -> None:
        replies = self._replies
        what = {"op": "acquire", "holder": holder()}

        def on_lease_reply(message: bytes) -> None:
            """Take a lease held by another, by a deadline in the robot's clock from its reply."""
            now = decoded(message).get("parameters", {}).get("now")
            held = error_name(message) == "LeaseHeld" and isinstance(now, int | float)
            if not (held and given.get("take")):
                granted(message)
                return
            taking = what | {"take": True, "deadline": now + LEASE_S}
            with suppress(Disconnected):  # closed meanwhile
                endpoint.ask(LEASE, taking, patience, granted, lambda: replies.answer(message))

        def granted(message: bytes) -> None:
            grant = decoded(message).get("parameters")
            if error_name(message) == "" and isinstance(grant, dict):
                with suppress(KeyError, TypeError, ValueError):  # else the caller reports an invalid answer
                    self._lease = HeldLease(endpoint, grant)
                    shown = {key: grant.get(key) for key in ("holder", "expires_in")}
                    message = json.dumps({"parameters": {"lease": shown}}).encode()
            replies.answer(message)

        self._ask(endpoint, LEASE, what, patience, on_lease_reply)

    def _release(self, endpoint: RemoteRobotEndpoint, _given: Parameters, patience: float) -> None:
        lease = self._lease
        self._lease = None
        if lease is None:
            self._replies.answer(b'{"parameters":{}}')
        else:
            self._ask(endpoint, LEASE, lease.query("release"), patience)

    def _renew(self, endpoint: RemoteRobotEndpoint, _given: Parameters, patience: float) -> None:
        self._ask(endpoint, LEASE, self._held("RenewLease").query("renew"), patience)

    def _go(self, endpoint: RemoteRobotEndpoint, given: Parameters, _patience: float) -> None:
        lease = self._held("SubmitTrajectory: from afar only under a lease")
        self._repeated = SentGoal(endpoint, lease, given["trajectory"], self._replies)

    def _held(self, call: str) -> HeldLease:
        if self._lease is None:
            raise NotCarried(f"{call}: AcquireLease comes first")
        return self._lease

    def _monitor(self, endpoint: RemoteRobotEndpoint, given: Parameters, _patience: float) -> None:
        rate = given.get("rate")
        for topic, parts in keys(given["topics"], rate).items():
            on_news = partial(_put_due, self._replies, TopicRateLimiter(topic, rate))
            self._subscribers.append(endpoint.subscribe_news(parts, on_news))


def _put_due(replies: ClientReplyQueue, limiter: TopicRateLimiter, message: bytes) -> None:
    if limiter.takes(message):
        replies.put_news(message)


def holder() -> str:
    """Return the text for the holder of its lease, as displayed at the robot."""
    try:
        return f"{getpass.getuser()}@{socket.gethostname()}"
    except (KeyError, OSError):  # a user without a name
        return socket.gethostname()
