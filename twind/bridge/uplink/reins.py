"""The daemon's lease, held for whoever has ours from afar, and the goals under it.

The motions are driven by `Driving`: the lease is renewed call by call. So a lease that lapses, a link that is
lost, a sender that dies and an uplink that hangs all end alike: nobody renews any more, and the daemon holds.
All calls are those of one lane, one after the other.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from twind.bridge.driving import LOST, Driving, Ended
from twind.bridge.uplink.contract import finding, invalid, no_daemon, refused
from twind.bridge.uplink.goals import Goal, Goals
from twind.bridge.uplink.plans import Plans
from twind.bridge.uplink.tenancy import Tenancy, missing
from twind.bridge.zenoh.keys import chunk
from twind.client import CallError, ClientError

PERIOD = 0.2  # s between two looks: a renewal, news of goals

Publish = Callable[[str, dict[str, Any]], None]  # what became of a goal, by its name


class Reins:
    """What is held. `tell` gets a line when it changes hands; `now`: s, the robot's clock."""

    def __init__(
        self,
        driving: Driving,
        tenancy: Tenancy,
        plans: Plans,
        publish: Publish,
        tell: Callable[[str], None],
        now: Callable[[], float],
    ) -> None:
        self._driving, self._tenancy, self._plans = driving, tenancy, plans
        self._publish, self._tell, self._now = publish, tell, now
        self._goals = Goals()
        self._holder = ""  # "": nobody

    # ------------------------------------------------------------------------------------------ questions

    def lease(self, asked: dict[str, Any]) -> dict[str, Any]:
        """Answer to `acquire` and `release`. Raises ClientError (CallError: LeaseHeld, refused)."""
        if asked["op"] == "release":
            return self._release(asked.get("lease", ""))
        take, holder = bool(asked.get("take")), str(asked.get("holder") or "somebody")
        self._tenancy.admits(self._now(), take=take)
        if self._holder:
            self._let_go(f"{holder} takes the lease that {self._holder} had")
        self._driving.hold(take=take)
        self._holder = holder
        self._tell(f"the lease is with {holder}")
        return self._tenancy.grant(holder, self._now())

    def _release(self, lease: str) -> dict[str, Any]:
        if not self._tenancy.holds(lease, self._now()):
            raise missing()
        granted = self._tenancy.granted(self._now()) | {"expires_in": 0.0}
        self._let_go(f"{self._holder} gave the lease back")
        return granted

    def goal(self, asked: dict[str, Any]) -> dict[str, Any]:
        """Answer to a goal: accepted, or what is known of it. Raises ClientError (CallError: refused)."""
        name, lease = asked["goal"], asked["lease"]
        known = self._goals.again(name, lease)
        if known is not None:
            return known.told()
        try:
            chunk("goal", name)
        except ValueError as error:
            raise invalid("goal", str(error)) from None
        if not self._tenancy.holds(lease, self._now()):
            raise missing()
        goal = self._goals.begin(name, lease, asked["deadline"], self._now())
        self._submit(goal, asked["trajectory"])
        return goal.told()

    def _submit(self, goal: Goal, trajectory: dict[str, Any]) -> None:
        """Have it judged and begun. Whether it runs is not left open: what is not answered is let go."""
        try:
            goal.answer = dict(self._driving.submit(trajectory))
        except CallError as error:
            goal.refusal = error
            return
        except ClientError as error:
            goal.refusal = no_daemon(error)
            self._let_go(f"goal {goal.name}: {error}")
            return
        goal.id = goal.answer["id"]
        if self._now() > goal.deadline:
            late = "it was accepted after its deadline, and stopped"
            goal.refusal = refused("CMD_EXPIRED", late, self._now() - goal.deadline, 0.0)
            self._let_go(f"goal {goal.name}: {late}")

    # ------------------------------------------------------------------------------------------ keeping

    def tend(self) -> None:
        """Renew while somebody renews ours, tell of goals. Each PERIOD at least, and after each question."""
        ended = {each.id: each for each in self._driving.keep()}
        if self._holder and not self._tenancy.held(self._now()):
            self._let_go(f"the lease of {self._holder} lapsed")
        elif self._holder and not self._driving.held:
            self._let_go(f"the daemon took the lease of {self._holder}: somebody else has it, or it restarts")
        for goal in self._goals.running():
            self._report(goal, ended.get(goal.id))

    def _let_go(self, why: str) -> None:
        """The daemon holds what moves."""
        self._driving.close()
        self._tenancy.end()
        self._holder = ""
        self._tell(why)

    def _report(self, goal: Goal, ended: Ended | None) -> None:
        """The end of a goal, or how far it is."""
        goal.over = ended is not None
        if goal.refusal is not None:
            return
        progress = self._plans.share(goal.id, self._now())
        goal.answer = {"id": goal.id, "phase": "running", "progress": progress}
        if ended is not None:
            goal.answer |= {"phase": ended.phase, "findings": list(ended.findings)}
            if ended.phase == "succeeded":
                goal.answer["progress"] = 1.0
            elif ended.phase == LOST:
                said = finding("LEASE_LOST", "how it ended was not heard; nothing moves under it any more")
                goal.answer |= {"phase": "aborted", "findings": [said]}
        self._publish(goal.name, goal.answer)

    def close(self) -> None:
        """Let go of all."""
        if self._holder:
            self._let_go("ended: the lease is given back")
