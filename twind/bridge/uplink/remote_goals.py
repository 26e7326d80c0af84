"""Lease and goals of remote clients, on the `LeasedMotions` of the daemon.

A lapsed lease, a lost link, a sender that dies and an uplink that hangs all end alike: the daemon holds.
While the daemon checks a goal, it renews its lease by itself; then `watch` detects a lapse of the remote
lease and disconnects. `renew`, `on_monitor_reply` and `watch` are for any thread, all else for one thread.
"""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from twind.bridge.commands.leased_motions import LeasedMotions, MotionRequest, refusal
from twind.bridge.commands.motion_end import LOST
from twind.bridge.uplink.goal_table import RemoteGoal, RemoteGoalTable, in_time
from twind.bridge.uplink.remote_contract import GoalQuery, LeaseQuery, as_call_error, invalid
from twind.bridge.uplink.remote_lease import RemoteLease, missing
from twind.bridge.zenoh.zenoh_keys import chunk
from twind.client import CallError
from twind.client.errors import as_error
from twind.robot.finding import ReasonCode

PERIOD = 0.2  # s between two looks at the lease
KEPT_PLANS = 64  # motions whose planned time is remembered
MOST_SHARE = 0.99  # of its time: only the daemon reports the end of a motion

Publish = Callable[[str, dict[str, Any]], None]  # publishes the state of a goal, by its name


def clock() -> float:
    """Return the robot's clock as published to remote clients, s. It runs on while the robot sleeps.

    So the lease of a robot that slept has lapsed.
    """
    return time.clock_gettime(time.CLOCK_BOOTTIME)


class RemoteGoals:
    """Goals of the holder of the remote lease.

    `tell` gets a line when the lease changes hands; `now`: s, the robot's clock as published.
    """

    def __init__(
        self,
        motions: LeasedMotions,
        publish: Publish,
        tell: Callable[[str], None],
        now: Callable[[], float] = clock,
    ) -> None:
        self._motions = motions
        self._publish = publish
        self._tell = tell
        self._now = now
        self._lease = RemoteLease()
        self._holder = ""  # "": none
        self._goals = RemoteGoalTable()
        self._plans: OrderedDict[str, tuple[float, float]] = OrderedDict()  # by id: begins, lasts; s

    # ------------------------------------------------------------------------------------------ queries

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

    def goal(self, query: GoalQuery, came: float) -> dict[str, Any]:
        """Return the answer to a goal: accepted, or its known state. Raises CallError: refused.

        `came`: s, monotonic, when it arrived here: a goal that is stopped after that does not begin.
        """
        known = self._goals.find_repeated(query.goal, query.lease)
        if known is not None:
            return known.latest_reply()
        trajectory = query.trajectory
        if trajectory is None or query.deadline is None:
            known_as = f"{query.goal[:64]!r} is not known"
            raise invalid("goal", f"{known_as}; a new one needs a deadline and a trajectory")
        try:
            chunk("goal", query.goal)
        except ValueError as error:
            raise invalid("goal", str(error)) from None
        if not self._lease.holds(query.lease, self._now()):
            raise missing()
        goal = self._goals.begin(query.goal, query.lease, query.deadline, self._now())
        report = partial(self._report, goal)
        objection = partial(self._objection, goal)
        self._motions.take(MotionRequest(lambda: trajectory, report, came, objection))
        return goal.latest_reply()

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
        self._motions.hold()
        granted = self._lease.grant(holder, self._now())
        self._holder = holder  # after the grant: `watch` disconnects a holder without it
        self._tell(f"the lease is with {holder}")
        return granted

    def _release(self, lease: str) -> dict[str, object]:
        if not self._lease.holds(lease, self._now()):
            raise missing()
        granted = self._lease.granted(self._now()) | {"expires_in": 0.0}
        self._let_go(f"{self._holder} gave the lease back")
        return granted

    # ------------------------------------------------------------------------------------------ goals

    def _objection(self, goal: RemoteGoal) -> CallError | None:
        """Return why the goal must not move anything, or no more; None: it may."""
        now = self._now()
        if not self._lease.holds(goal.lease, now):
            return missing()
        if now > goal.deadline:
            late = now - goal.deadline
            text = "its deadline passed before it began"
            return refusal(ReasonCode.CMD_EXPIRED, text, value=late, bound=0.0)
        return None

    def _report(self, goal: RemoteGoal, phase: str, fields: Mapping[str, Any]) -> None:
        """Take a report of the motions; publish what follows the verdict."""
        if phase == "refused":
            goal.refusal = as_call_error(fields["error"])
            return
        if phase == "accepted":
            goal.answer = dict(fields["answer"])
            goal.id = goal.answer["id"]
            return
        answer = {"id": goal.id, "phase": phase, "progress": self._share(goal.id, time.monotonic())}
        if phase != "running":
            goal.over = True
            answer |= {"phase": "aborted" if phase == LOST else phase, "findings": list(fields["findings"])}
            if phase == "succeeded":
                answer["progress"] = 1.0
        goal.answer = answer
        self._publish(goal.name, answer)

    def _share(self, name: str, now: float) -> float:
        """Return the elapsed share of a motion's planned time, 0..MOST_SHARE; it may be slowed on the way."""
        begins, lasts = self._plans.get(name, (now, 1.0))
        return min(MOST_SHARE, max(0.0, (now - begins) / max(lasts, 1e-3)))

    def on_monitor_reply(self, answer: Mapping[str, Any]) -> None:
        """Take an answer of `Monitor`: topics events, status and trajectories."""
        if answer["topic"] != "trajectories":
            self._motions.on_monitor_reply(answer)
            return
        path = answer["accepted"]["trajectory"]
        begins = answer["time"] + (path.get("start_in") or 0.0)
        self._plans[answer["accepted"]["id"]] = begins, path["points"][-1]["time_from_start"]
        while len(self._plans) > KEPT_PLANS:
            self._plans.popitem(last=False)

    # ------------------------------------------------------------------------------------------ the lease

    def keep(self) -> None:
        """Report goals; keep the daemon's lease while the remote one is renewed. Call it each PERIOD."""
        self._motions.keep()
        if self._holder and not self._lease.is_held(self._now()):
            self._let_go(f"the lease of {self._holder} lapsed")
        elif self._holder and not self._motions.held:
            self._let_go(f"the daemon took the lease of {self._holder}: another client has it, or a restart")

    def watch(self) -> None:
        """Disconnect if the lease lapsed though the thread of the motions waits. Call it each PERIOD."""
        if self._holder and not self._lease.is_held(self._now()):
            self._motions.cut()

    def close(self) -> None:
        """Release the lease and all goals."""
        if self._holder:
            self._let_go("ended: the lease is given back")
        self._motions.close()

    def _let_go(self, why: str) -> None:
        """Give the lease up: the daemon holds whatever moves."""
        self._motions.release()
        self._lease.end()
        self._holder = ""
        self._tell(why)
