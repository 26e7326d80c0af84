"""A remote robot behind an ordinary `twind.client.Client`: each call becomes a query over Zenoh.

Calls that no uplink carries are refused here, before anything is sent: arming and changing the mode require
presence beside the robot.
"""

import getpass
import json
import socket
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from typing import Any, Protocol

import zenoh

from twind.bridge.fleet.client_reply_queue import ClientReplyQueue
from twind.bridge.fleet.lease_renewer import LeaseRenewer
from twind.bridge.fleet.remote_stop import RemoteStop
from twind.bridge.fleet.robot_endpoint import RemoteRobotEndpoint, TakeMessage, error_name
from twind.bridge.fleet.sent_goal import SentGoal
from twind.bridge.fleet.topic_rate_limiter import TopicRateLimiter, keys
from twind.bridge.zenoh.zenoh_keys import ASKED, LEASE_S, STOPS, robot_key
from twind.client import Disconnected, NoDaemon, NotCarried

FOUND = 2.0  # s within which a robot that is there is found
IDLE = 5.0  # s between two polls of an idle line
PARTING = 0.5  # s that giving a lease back may take when the line is closed
Parameters = Mapping[str, Any]


class SessionProvider(Protocol):
    """Source of sessions: one of its own for each line, or one that many share."""

    @property
    def where(self) -> str:
        """Name of the network, for display."""

    def open_session(self, patience: float) -> zenoh.Session:
        """Return a session. Raises ClientError: the network cannot be joined."""

    def release_session(self, session: zenoh.Session) -> None:
        """Release a session that is needed no more."""


class ZenohClientLine:
    """A `twind.client.client_line.ClientLine` to `robot`, its name in the key space.

    Raises ValueError: not a valid name.
    """

    def __init__(self, robot: str, way: SessionProvider) -> None:
        robot_key(robot)
        self.where = f"robot {robot} by {way.where}"
        self._robot = robot
        self._way = way
        self._reach: RemoteRobotEndpoint | None = None
        self._inbox = ClientReplyQueue()
        self._hold: LeaseRenewer | None = None
        self._there = threading.Event()
        self._errand: SentGoal | RemoteStop | None = None  # goal or stop under way
        self._subscribers: list[zenoh.Subscriber[None]] = []

    @property
    def is_open(self) -> bool:
        """True while the network is joined and the line is not closed."""
        return self._reach is not None

    def open(self, patience: float) -> None:
        """Join the network. Raises NoDaemon. The first query shows whether the robot is there."""
        if self._reach is not None:
            return
        reach = RemoteRobotEndpoint(self._way.open_session(patience), self._robot)
        inbox = self._inbox = ClientReplyQueue()
        try:
            self._there = threading.Event()
            gone = f"{self.where}: it went away, or the way to it is lost"
            self._subscribers = [reach.watch(self._there.set, lambda: inbox.end(gone))]
        except BaseException:
            self._forget(reach)
            raise
        self._reach = reach

    def close(self) -> None:
        """Close the line. A lease is given back, else it lapses: motion under it ends in a hold."""
        if self._reach is None:
            return
        reach = self._reach
        self._reach = None
        if self._hold is not None and not self._hold.lost:
            released = threading.Event()
            with suppress(Disconnected):
                reach.ask(*_release(self._hold), PARTING, lambda _: released.set(), released.set)
                released.wait(
                    PARTING
                )  # else the session closes before the query is sent, and the lease only lapses
        self._forget(reach)

    def cut(self) -> None:
        """End the wait for messages in another thread: nothing comes any more."""
        self._inbox.end(f"{self.where}: hung up")

    def _forget(self, reach: RemoteRobotEndpoint) -> None:
        if self._errand is not None:
            self._errand.close()
        for each in self._subscribers:
            each.undeclare()
        self._errand = None
        self._hold = None
        self._subscribers = []
        self._way.release_session(reach.session)

    # ------------------------------------------------------------------------------------------ messages

    def send(self, message: bytes, patience: float) -> None:
        """Send a query. Raises NotCarried; NoDaemon: the robot is not there.

        A stop is sent without waiting for the robot to be seen.
        """
        assert self._reach is not None
        call = json.loads(message)
        method = call["method"].rpartition(".")[2]
        more = bool(call.get("more"))
        parameters: Parameters = call["parameters"]
        if method in STOPS:  # the presence token may be late or lost, and the robot would go on moving
            self._errand = RemoteStop(self._reach, method, parameters, self._inbox, time.monotonic())
            return
        carry = self._carrier(method, more)
        if not self._there.wait(min(patience, FOUND)):
            self.close()
            raise NoDaemon(f"{self.where}: not present; `twindctl fleet` lists the robots", absent=True)
        carry(parameters, patience)

    def receive(self, patience: float) -> bytes:
        """The next message. Raises TimeoutError, Disconnected, NoDaemon."""
        deadline = time.monotonic() + patience
        while (left := deadline - time.monotonic()) > 0.0:
            message = self._inbox.take(min(left, self._keep_requests_alive()))
            if message is not None:
                return self._understood(message)
        raise TimeoutError

    def take_received(self) -> list[bytes]:
        """Return the messages that have come already."""
        return self._inbox.rest()

    def _keep_requests_alive(self) -> float:
        """Tend the call under way, alive only while a caller waits here; return s until the next time."""
        errand = self._errand
        return IDLE if errand is None or errand.over else errand.poll(time.monotonic())

    def _understood(self, message: bytes) -> bytes:
        if message.startswith(b'{"error"') and error_name(message) == "NoDaemon":
            why = json.loads(message).get("parameters", {}).get("message", "")
            raise NoDaemon(f"{self.where}: its uplink is there, its daemon is not: {why}")
        return message

    # ------------------------------------------------------------------------------------------ calls

    def _carrier(self, method: str, more: bool) -> Callable[[Parameters, float], None]:
        """Return the function that makes a call. Raises NotCarried."""
        if method in ASKED:
            return partial(self._ask, ("ask", method))
        if method == "Check":
            return partial(self._ask, ("check",))
        if method in _LEASE:
            return partial(_LEASE[method], self)
        if method in _STREAMS and more:
            return partial(_STREAMS[method], self)
        raise NotCarried(
            f"{method}: not for remote clients; arm {self._robot} and set it up beside the robot"
        )

    def _ask(
        self,
        parts: tuple[str, ...],
        what: Parameters,
        patience: float,
        answered: TakeMessage | None = None,
    ) -> None:
        assert self._reach is not None
        inbox = self._inbox
        silent = (
            f"{self.where}: no answer to {'/'.join(parts)}: it went away, or this client is not permitted"
        )
        self._reach.ask(parts, what, patience, answered or inbox.answer, lambda: inbox.end(silent))

    def _acquire(self, parameters: Parameters, patience: float) -> None:
        assert self._reach is not None
        inbox = self._inbox
        reach = self._reach
        what = {"op": "acquire", "holder": holder()}

        def on_lease_reply(message: bytes) -> None:
            """Take a lease held by another, by a deadline in the robot's clock from its reply."""
            now = _held_at(message) if parameters.get("take") else None
            if now is None:
                granted(message)
                return
            taking = what | {"take": True, "deadline": now + LEASE_S}
            with suppress(Disconnected):  # closed meanwhile
                reach.ask(("lease",), taking, patience, granted, lambda: inbox.answer(message))

        def granted(message: bytes) -> None:
            came = time.monotonic()
            try:
                answer = json.loads(message)
                if "error" in answer:  # LeaseHeld has a lease and a clock as well
                    inbox.answer(message)
                    return
                grant = answer["parameters"]
                self._hold = LeaseRenewer(reach, grant, came)
            except (ValueError, KeyError, TypeError):
                inbox.answer(message)  # the caller reports an invalid answer
            else:
                lease = {"holder": grant.get("holder"), "expires_in": grant.get("expires_in")}
                inbox.answer(json.dumps({"parameters": {"lease": lease}}).encode())

        self._ask(("lease",), what, patience, on_lease_reply)

    def _release(self, _parameters: Parameters, patience: float) -> None:
        hold = self._hold
        self._hold = None
        if hold is None:
            self._inbox.answer(b'{"parameters":{}}')
        else:
            self._ask(*_release(hold), patience)

    def _renew(self, _parameters: Parameters, patience: float) -> None:
        if self._hold is None:
            raise NotCarried("RenewLease: AcquireLease comes first")
        self._ask(("lease",), {"op": "renew", "lease": self._hold.id}, patience)

    def _submit(self, parameters: Parameters, _patience: float) -> None:
        if self._hold is None:
            raise NotCarried("SubmitTrajectory: from afar only under a lease; AcquireLease comes first")
        assert self._reach is not None
        now = time.monotonic()
        self._errand = SentGoal(self._reach, self._hold, parameters["trajectory"], self._inbox, now)

    def _monitor(self, parameters: Parameters, _patience: float) -> None:
        assert self._reach is not None
        rate = parameters.get("rate")
        for topic, parts in keys(parameters["topics"], rate).items():
            self._subscribers.append(
                self._reach.subscribe_news(parts, self._thinned(TopicRateLimiter(topic, rate)))
            )

    def _thinned(self, thinned: TopicRateLimiter) -> Callable[[bytes], None]:
        inbox = self._inbox

        def on_message(message: bytes) -> None:
            if thinned.takes(message):
                inbox.put_news(message)

        return on_message


def holder() -> str:
    """Return the text for the holder of its lease, as displayed at the robot."""
    try:
        return f"{getpass.getuser()}@{socket.gethostname()}"
    except (KeyError, OSError):  # a user without a name
        return socket.gethostname()


def _held_at(message: bytes) -> float | None:
    """Return the time (s, robot's clock) at which another client had the lease; None: another message."""
    try:
        answer = json.loads(message)
        held = str(answer.get("error")).endswith(".LeaseHeld")
        return float(answer["parameters"]["now"]) if held else None
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None


def _release(hold: LeaseRenewer) -> tuple[tuple[str, ...], Parameters]:
    return ("lease",), {"op": "release", "lease": hold.id}


_LEASE = {
    "AcquireLease": ZenohClientLine._acquire,
    "RenewLease": ZenohClientLine._renew,
    "ReleaseLease": ZenohClientLine._release,
}
_STREAMS = {"Monitor": ZenohClientLine._monitor, "SubmitTrajectory": ZenohClientLine._submit}
