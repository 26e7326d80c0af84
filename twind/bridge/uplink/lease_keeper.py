"""Keeper of the daemon's lease for the holder of the remote lease, and of the goals under it.

`MotionSession` runs the motions: it renews the lease call by call. A lapsed lease, a lost link, a sender that
dies and an uplink that hangs all end alike: renewals stop, and the daemon holds. While the daemon checks a
goal, it renews by itself; then `watch` detects a lapse of the remote lease, and disconnects. `renew`,
`stopped`, `on_monitor_reply` and `watch` are for any thread, all else for one.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from math import inf
from typing import Any

from twind.bridge.motion_session import LOST, MotionEnd, MotionSession, reported_end
from twind.bridge.uplink.remote_contract import (
    GoalQuery,
    LeaseQuery,
    finding,
    invalid,
    make_refusal,
    no_daemon,
)
from twind.bridge.uplink.remote_lease import RemoteLease, missing
from twind.bridge.uplink.uplink_goals import PlannedDurations, UplinkGoal, UplinkGoalTable, in_time
from twind.bridge.zenoh.zenoh_keys import chunk
from twind.client import CallError, ClientError, Refused
from twind.client.errors import as_error
from twind.robot.finding import ReasonCode

PERIOD = 0.2  # s between two renewals and checks of goals

BUSY = ReasonCode.BUSY  # finding of the gate for a path that it drops, as at a stop

Publish = Callable[[str, dict[str, Any]], None]  # publishes the state of a goal, by its name


def clock() -> float:
    """Return the robot's clock as published to remote clients, s. It runs on while the robot sleeps.

    So the lease of a robot that slept has lapsed.
    """
    return time.clock_gettime(time.CLOCK_BOOTTIME)


class LeaseKeeper:
    """Keeper of the daemon's lease and its goals.

    `tell` gets a line when the lease changes hands; `now`: s, the robot's clock as published to remote
    clients.
    """

    def __init__(
        self,
        driving: MotionSession,
        lease: RemoteLease,
        plans: PlannedDurations,
        publish: Publish,
        tell: Callable[[str], None],
        now: Callable[[], float] = clock,
    ) -> None:
        self._driving = driving
        self._lease = lease
        self._plans = plans
        self._publish = publish
        self._tell = tell
        self._now = now
        self._goals = UplinkGoalTable()
        self._holder = ""  # "": none
        self._judging = False
        self._dropped: frozenset[str] = frozenset()  # motions that ended with a lease of this uplink: no stop
        self._lock = threading.Lock()
        self._stopped = -inf  # s, monotonic: goals that came in before are void

    # ------------------------------------------------------------------------------------------ questions

    def renew(self, query: LeaseQuery) -> dict[str, object]:
        """Return the answer to `renew`. Raises CallError: refused."""
        return self._lease.renew(query.lease, self._now())

    def lease(self, query: LeaseQuery) -> dict[str, object]:
        """Answer `acquire` and `release`. Raises ClientError (CallError: LeaseHeld, refused)."""
        if query.op == "release":
            return self._release(query.lease)
        try:
            return self._acquire(query)
        except CallError as error:
            if error.name != "LeaseHeld":
                raise
            now = {"now": self._now()}  # by which a deadline can be given to a `take`
            raise as_error(error.error, {**error.parameters, **now}) from None

    def _acquire(self, query: LeaseQuery) -> dict[str, object]:
        """Take the lease, from other remote holders only: a local holder stands beside the moving robot."""
        holder = query.holder or "an unnamed client"
        if query.take and query.deadline is None:
            raise invalid("deadline", "take is only for what has one: acquire without take returns `now`")
        if query.deadline is not None:
            in_time(query.deadline, self._now())
        self._lease.admits(self._now(), take=query.take)
        if self._holder:
            self._let_go(f"{holder} takes the lease that {self._holder} had")
        self._driving.hold()
        self._holder = holder
        self._tell(f"the lease is with {holder}")
        return self._lease.grant(holder, self._now())

    def _release(self, lease: str) -> dict[str, object]:
        if not self._lease.holds(lease, self._now()):
            raise missing()
        granted = self._lease.granted(self._now()) | {"expires_in": 0.0}
        self._let_go(f"{self._holder} gave the lease back")
        return granted

    def goal(self, query: GoalQuery, came: float) -> dict[str, object]:
        """Return the answer to a goal: accepted, or its known state. Raises ClientError (CallError: refused).

        `came`: s, monotonic, when it arrived here: a goal that is stopped after that does not begin.
        """
        name = query.goal
        lease = query.lease
        known = self._goals.find_repeated(name, lease)
        if known is not None:
            return known.latest_reply()
        if query.trajectory is None or query.deadline is None:
            raise invalid("goal", f"{name[:64]!r} is not known; a new one needs a deadline and a trajectory")
        try:
            chunk("goal", name)
        except ValueError as error:
            raise invalid("goal", str(error)) from None
        if not self._lease.holds(lease, self._now()):
            raise missing()
        goal = self._goals.begin(name, lease, query.deadline, self._now())
        goal.refusal = self._void(goal, came)
        if goal.refusal is None:
            self._submit(goal, query.trajectory, came)
        return goal.latest_reply()

    def _submit(self, goal: UplinkGoal, trajectory: Mapping[str, object], came: float) -> None:
        """Submit the goal to be judged and begun. Without an answer it is released: no state is left open."""
        self._judging = True
        try:
            goal.answer = dict(self._driving.submit(trajectory))
            goal.id = goal.answer["id"]
            goal.refusal = self._void(goal, came)
        except CallError as error:
            goal.refusal = error
            if isinstance(error, Refused) and BUSY in {each["code"] for each in error.findings}:
                # The gate drops paths at a stop: waiting goals must not begin after it either.
                self.stopped(time.monotonic())
            return
        except ClientError as error:
            goal.refusal = self._void(goal, came) or no_daemon(error)
        finally:
            self._judging = False
        if goal.refusal is not None:
            self._let_go(f"goal {goal.name}: {goal.refusal}")

    def _void(self, goal: UplinkGoal, came: float) -> CallError | None:
        """Return why the goal must not move anything, or no more; None: it may."""
        now = self._now()
        if not self._lease.holds(goal.lease, now):
            return missing()
        if now > goal.deadline:
            return make_refusal(
                ReasonCode.CMD_EXPIRED, "its deadline passed before it began", now - goal.deadline, 0.0
            )
        with self._lock:
            stopped = came <= self._stopped
        return (
            make_refusal(BUSY, "the robot was stopped after this was sent: send it again")
            if stopped
            else None
        )

    # ------------------------------------------------------------------------------------------ any thread

    def stopped(self, at: float) -> None:
        """Record a stop of the robot at `at`, s, monotonic: no goal that came in until then begins."""
        with self._lock:
            self._stopped = max(self._stopped, at)

    def on_monitor_reply(self, answer: Mapping[str, Any]) -> None:
        """Take an answer of `Monitor`, topics events and status: stops by others, ends."""
        self._driving.on_monitor_reply(answer)
        ended = reported_end(answer)
        if ended is not None and ended.stopped and ended.id not in self._dropped:
            self.stopped(answer["time"])

    def watch(self) -> None:
        """Disconnect if the lease lapsed while a goal is judged. Called each PERIOD, in a separate thread."""
        if self._judging and not self._lease.is_held(self._now()):
            self._dropped = frozenset(self._driving.driving)
            self._driving.cut()

    # ------------------------------------------------------------------------------------------ keeping

    def renew_and_report(self) -> None:
        """Renew while the remote lease is renewed; report goals. Each PERIOD at least, after each query."""
        ended = {each.id: each for each in self._driving.keep()}
        if self._holder and not self._lease.is_held(self._now()):
            self._let_go(f"the lease of {self._holder} lapsed")
        elif self._holder and not self._driving.held:
            self._let_go(f"the daemon took the lease of {self._holder}: another client has it, or a restart")
        for goal in self._goals.running():
            self._report(goal, ended.get(goal.id))

    def _let_go(self, why: str) -> None:
        """Give the lease up: the daemon holds whatever moves."""
        self._dropped = frozenset(self._driving.driving)
        self._driving.close()
        self._lease.end()
        self._holder = ""
        self._tell(why)

    def _report(self, goal: UplinkGoal, ended: MotionEnd | None) -> None:
        """Report the end of a goal, or its progress."""
        goal.over = ended is not None
        if goal.refusal is not None:
            return
        progress = self._plans.share(goal.id, time.monotonic())
        goal.answer = {"id": goal.id, "phase": "running", "progress": progress}
        if ended is not None:
            goal.answer |= {"phase": ended.phase, "findings": list(ended.findings)}
            if ended.phase == "succeeded":
                goal.answer["progress"] = 1.0
            elif ended.phase == LOST:
                unknown = finding(ReasonCode.LEASE_LOST, "no report of its end came; nothing moves under it")
                goal.answer |= {"phase": "aborted", "findings": list(ended.findings) or [unknown]}
        self._publish(goal.name, goal.answer)

    def close(self) -> None:
        """Release the lease and all goals."""
        if self._holder:
            self._let_go("ended: the lease is given back")
