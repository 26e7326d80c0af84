"""Trajectories from ROS on their way to the gate, and every outcome told. Standard library, Python 3.10.

Whoever hears a command puts it down and goes on (`put`, `goal`); one thread takes it to the daemon (`step`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from twind.bridge.driving import Driving
from twind.bridge.ros.endpoints import TRAJECTORY
from twind.bridge.ros.goal import Heading, Unfit, heading, trajectory
from twind.bridge.ros.inbox import PACE, ROOM, Command, Inbox, Told
from twind.client import CallError, Client, ClientError, Refused

PATIENT = 1.0  # s that a command may wait: what was meant for then is not done later
RUNNING = 1.0  # s between two words to whoever follows a motion

Result = dict[str, Any]


class Orders:
    """`put`, `goal`, `stop`, `heard` may be called from any thread; `step` and `close` belong to one."""

    def __init__(
        self,
        operator: Callable[[], Client],
        say: Told,
        wall_ns: Callable[[], int] = time.time_ns,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        """`say` gets every outcome. `wall_ns`: the clock that stamps are read by, ns since 1970."""
        self._driving, self._inbox = Driving(operator, now), Inbox(now)
        self._say, self._wall_ns, self._now = say, wall_ns, now
        self._epoch = 0
        self._begun: dict[str, Command] = {}
        self._said = 0.0  # s, monotonic, when motions were last said to run

    def put(self, data: bytes) -> None:
        """A command came: CDR bytes of a JointTrajectory. Returns at once."""
        self._put(Command(data, heading(data), self._now(), self._epoch))

    def goal(
        self,
        data: bytes,
        told: Told,
        *,
        goal_time: float | None = None,
        tolerances: Sequence[Mapping[str, Any]] | None = None,
    ) -> Callable[[], None]:
        """A command whose sender follows it: `told` hears each `phase`. The answer cancels it: all holds."""
        given = {"goal_time": goal_time, "tolerances": tolerances}
        more = {key: value for key, value in given.items() if value is not None}
        command = Command(data, heading(data), self._now(), self._epoch, told, more)
        self._put(command)

        def cancel() -> None:
            command.cancelled = True
            self._inbox.wake()

        return cancel

    def stop(self) -> None:
        """Somebody stops the robot: nothing that was asked for before begins after it."""
        self._epoch += 1
        self._inbox.wake()

    def heard(self, answer: Mapping[str, Any]) -> None:
        """An answer of `Monitor`, topics events and status."""
        self._driving.heard(answer)

    @property
    def driving(self) -> tuple[str, ...]:
        """Motions of ours that are under way."""
        return self._driving.driving

    def step(self, patience: float) -> None:
        """Wait up to `patience` s for a command, take it to the daemon, tell what ended."""
        command = self._inbox.take(patience)
        if command is not None:
            self._take(command)
        for command in self._begun.values():
            if command.cancelled:
                command.cancelled = False
                self._cancel()
        for ended in self._driving.keep():
            known = self._begun.pop(ended.id, None)
            if known is not None:
                message = "; ".join(str(each.get("message", "")) for each in ended.findings)
                self._tell(known, ended.phase, id=ended.id, message=message, findings=ended.findings)
        self._tell_running()
        self._tell_dropped()

    def close(self) -> None:
        """Give the lease back: what is under way is let go, and the daemon holds."""
        self._driving.close()

    # ------------------------------------------------------------------------------------------ one command

    def _put(self, command: Command) -> None:
        for gone in self._inbox.put(command):
            self._tell(gone, "refused", message=f"more than {ROOM} commands wait: send it again")

    def _take(self, command: Command) -> None:
        if command.cancelled:
            self._tell(command, "cancelled")
            return
        try:
            self._admit(command)
            asked = {**trajectory(command.data, self._wall_ns()), **command.more}
            answer = self._driving.submit(asked)
        except Unfit as unfit:
            self._tell(command, "refused", message=str(unfit), findings=unfit.findings)
        except Refused as refusal:
            self._tell(command, "refused", message=str(refusal), findings=refusal.findings)
        except CallError as error:
            self._tell(command, "refused", message=str(error), error=error.name)
        except ClientError as error:
            self._tell(command, "refused", message=str(error), error=type(error).__name__)
        else:
            self._accepted(command, answer)

    def _admit(self, command: Command) -> None:
        """It is still wanted. Raises Unfit."""
        waited = self._now() - command.came
        if command.epoch != self._epoch:
            raise Unfit("BUSY", "the robot was stopped after this was sent: send it again")
        if waited > PATIENT:
            why = f"waited {waited:.1f} s here, at most {PATIENT:g}: send it again"
            raise Unfit("CMD_EXPIRED", why, value=waited, bound=PATIENT)

    def _accepted(self, command: Command, answer: Mapping[str, Any]) -> None:
        self._begun[answer["id"]] = command
        self._inbox.accepted(command)
        verdict = answer.get("verdict") or {}
        more = {key: verdict[key] for key in ("warnings", "changes") if verdict.get(key)}
        self._tell(command, "accepted", id=answer["id"], **more)
        if command.epoch != self._epoch:  # stopped while it was judged: the stop wins
            self._cancel()

    def _cancel(self) -> None:
        try:
            self._driving.cancel()
        except ClientError:
            self._driving.close()  # its lease goes with it, and the daemon holds

    # ------------------------------------------------------------------------------------------ what is told

    def _tell(self, command: Command, phase: str, **more: Any) -> None:
        result = result_of(command.head, phase, **more)
        self._say(result)
        if command.told is not None:
            command.told(result)

    def _tell_running(self) -> None:
        """Whoever follows a motion knows that we are there."""
        now = self._now()
        if now - self._said >= RUNNING:
            self._said = now
            for name, command in self._begun.items():
                if command.told is not None:
                    command.told(result_of(command.head, "running", id=name))

    def _tell_dropped(self) -> None:
        found = self._inbox.dropped()
        if found is not None:
            count, head = found
            why = f"{count} commands came faster than {1.0 / PACE:.0f} a second: newer ones took their place"
            self._say(result_of(head, "dropped", message=why, count=count))


def result_of(head: Heading | None, phase: str, **more: Any) -> Result:
    """One message of /bridge/results on a trajectory: whose it was, and what became of it."""
    known = head or Heading()
    stamp = {"sec": known.sec, "nanosec": known.nanosec}
    said = {key: value for key, value in more.items() if value not in (None, "", ())}
    return {"topic": TRAJECTORY.name, "stamp": stamp, "frame_id": known.frame, "phase": phase, **said}
