"""Dispatcher of trajectories from ROS to the gate, with a report of every outcome.

Standard library, Python 3.10.

A receiving thread queues a command (`put`, `goal`); one thread takes it to the daemon (`step`).
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from math import inf
from typing import Any

from twind.bridge.motion_session import LEASE_LOST, LOST, MotionSession, reported_end
from twind.bridge.ros.ros_command_queue import PACE, ROOM, Report, RosCommand, RosCommandQueue
from twind.bridge.ros.ros_endpoints import TRAJECTORY
from twind.bridge.ros.ros_trajectory import LONGEST, CommandHeader, heading, invalid_command, trajectory
from twind.client import CallError, Client, ClientError, Refused

PATIENT = 1.0  # s that a command may wait: what was meant for then is not done later
RUNNING = 1.0  # s between two reports to the receiver of a motion
SOON = 2.0  # s for the answer to a cancel
MORE = 64 << 10  # bytes of JSON that tolerances may take beside a path
NO_END_REPORT = "no report of its end came, though the daemon moves nothing any more: see its log"

Result = dict[str, Any]


class TrajectoryDispatcher:
    """Dispatcher.

    `put`, `goal`, `stop`, `on_monitor_reply` may be called from any thread; `step` and `close` from one.
    """

    def __init__(
        self,
        operator: Callable[[], Client],
        on_result: Report,
        wall_ns: Callable[[], int] = time.time_ns,
        now: Callable[[], float] = time.monotonic,
        closed: Callable[[], str] = str,
    ) -> None:
        """Make the dispatcher; `on_result` gets every outcome. `wall_ns`: clock of the stamps, ns since 1970.

        `closed`: why no command is taken; "": they are.
        """
        self._driving = MotionSession(operator, now)
        self._inbox = RosCommandQueue(now)
        self._operator = operator
        self._on_result = on_result
        self._wall_ns = wall_ns
        self._now = now
        self._closed = closed
        self._stopped = -inf  # s, monotonic: what came before is void
        # of the daemon, and the time of its last message
        self._mode = ""
        self._mode_at = -inf
        self._let_go: set[str] = set()  # motions that this bridge cancels for their client
        self._begun: dict[str, RosCommand] = {}
        self._running_reported = 0.0  # s, monotonic, last report of running motions

    def put(self, data: bytes) -> None:
        """A command came: CDR bytes of a JointTrajectory. Returns at once."""
        self._put(RosCommand(data[: LONGEST + 1], heading(data), self._now()))

    def goal(
        self,
        data: bytes,
        report: Report,
        *,
        goal_time: float | None = None,
        tolerances: Sequence[Mapping[str, Any]] | None = None,
    ) -> Callable[[], None]:
        """Queue a command with a receiver: `report` gets each `phase`.

        The returned function cancels it: all holds.
        """
        given = {"goal_time": goal_time, "tolerances": tolerances}
        more = {key: value for key, value in given.items() if value is not None}
        command = RosCommand(data[: LONGEST + 1], heading(data), self._now(), report, more)
        self._put(command)

        def cancel() -> None:
            if command.began == inf or not self._cancelled():
                command.cancelled = True
                self._inbox.wake()

        return cancel

    def stop(self) -> None:
        """Cancel everything requested before: after a stop none of it begins."""
        self._void(self._now())

    def on_monitor_reply(self, answer: Mapping[str, Any]) -> None:
        """Take an answer of `Monitor`, topics events and status. A stop by another client counts too."""
        self._driving.on_monitor_reply(answer)
        if answer["topic"] == "events":
            ended = reported_end(answer)
            stopped = ended is not None and ended.stopped and ended.id not in self._let_go
            if stopped or answer["event"]["code"] == LEASE_LOST:
                self._void(answer["time"])
        elif answer["topic"] == "status":
            mode = answer["status"]["mode"]
            if self._mode and mode != self._mode:
                self._void(self._mode_at)  # it was another one after that
            self._mode = mode
            self._mode_at = answer["time"]

    @property
    def driving(self) -> tuple[str, ...]:
        """Motions of this bridge that are under way."""
        return self._driving.driving

    def step(self, patience: float) -> None:
        """Wait up to `patience` s for a command, take it to the daemon, report the motions that ended."""
        command = self._inbox.take(patience)
        if command is not None:
            self._take(command)
        self._withdraw()
        for ended in self._driving.keep():
            known = self._begun.pop(ended.id, None)
            self._let_go.discard(ended.id)
            if known is not None:
                known.began = inf
                message = "; ".join(str(each.get("message", "")) for each in ended.findings)
                if ended.phase == LOST and not message:
                    message = NO_END_REPORT
                self._report_phase(known, ended.phase, id=ended.id, message=message, findings=ended.findings)
        self._report_running()
        self._report_dropped()

    def close(self) -> None:
        """Give the lease back: motions under way are cancelled, and the daemon holds."""
        self._driving.close()
        for name, command in self._begun.items():
            self._report_phase(
                command, "cancelled", id=name, message="the bridge ended: the robot decelerates and holds"
            )
        self._begun.clear()

    # ------------------------------------------------------------------------------------------ one command

    def _put(self, command: RosCommand) -> None:
        for gone in self._inbox.put(command):
            self._report_phase(gone, "refused", message=f"more than {ROOM} commands wait: send it again")

    def _take(self, command: RosCommand) -> None:
        if command.cancelled:
            self._report_phase(command, "cancelled")
            return
        closed = self._closed()
        if closed:
            command.data = b""
            self._report_phase(command, "refused", message=closed, error="NotAllowed")
            return
        try:
            answer = self._driving.submit(self._make_request(command))
        except Refused as refusal:
            self._report_phase(command, "refused", message=str(refusal), findings=refusal.findings)
        except CallError as error:
            self._report_phase(command, "refused", message=call_text(error), error=error.name)
        except ClientError as error:
            self._report_phase(command, "refused", message=str(error), error=type(error).__name__)
        except Exception as error:  # noqa: BLE001  the sender gets a report of any failure
            self._report_phase(
                command, "refused", message=f"{type(error).__name__}: {error}", error="internal"
            )
        else:
            self._accepted(command, answer)

    def _make_request(self, command: RosCommand) -> dict[str, Any]:
        """Return the daemon's Trajectory. Raises Refused, also for a command that is void or too old."""
        # it may be long, and a motion too
        data = command.data
        command.data = b""
        waited = self._now() - command.came
        if command.came <= self._stopped:
            raise invalid_command("BUSY", "the robot was stopped after this was sent: send it again")
        if waited > PATIENT:
            why = f"waited {waited:.1f} s here, at most {PATIENT:g}: send it again"
            raise invalid_command("CMD_EXPIRED", why, value=waited, bound=PATIENT)
        size = len(json.dumps(command.more))
        if size > MORE:
            raise invalid_command("FRAME_TOO_LARGE", f"tolerances of {size} bytes: must be at most {MORE}")
        return {**trajectory(data, self._wall_ns()), **command.more}

    def _accepted(self, command: RosCommand, answer: Mapping[str, Any]) -> None:
        command.began = self._now()
        self._begun[answer["id"]] = command
        self._inbox.accepted(command)
        verdict = answer.get("verdict") or {}
        more = {key: verdict[key] for key in ("warnings", "changes") if verdict.get(key)}
        self._report_phase(command, "accepted", id=answer["id"], **more)

    # ------------------------------------------------------------------------------------------ stops

    def _void(self, time: float) -> None:
        """Stopped at `time`, s, monotonic."""
        self._stopped = max(self._stopped, time)
        self._inbox.wake()

    def _withdraw(self) -> None:
        """Cancel what its sender does not want any more, and what began after a stop that it came before."""
        begun = self._begun.values()
        time = self._stopped
        due = [each for each in begun if each.cancelled or each.came <= time <= each.began]
        for each in due:
            each.cancelled = False
            each.began = -inf
        if due and not self._cancelled():
            self._driving.close()  # its lease goes with it, and the daemon holds

    def _cancelled(self) -> bool:
        """Decelerate and hold, on a connection of its own, so that no path that is judged is before it."""
        self._let_go.update(self._driving.driving)
        try:
            with self._operator() as client:
                client.timeout = SOON
                client.call("Cancel")
        except ClientError:
            return False
        return True

    # ------------------------------------------------------------------------------------------ reports

    def _report_phase(self, command: RosCommand, phase: str, **more: Any) -> None:
        result = result_of(command.head, phase, **more)
        self._on_result(result)
        if command.report is not None:
            command.report(result)

    def _report_running(self) -> None:
        """Report to receivers of a motion that it still runs."""
        now = self._now()
        if now - self._running_reported >= RUNNING:
            self._running_reported = now
            for name, command in self._begun.items():
                if command.report is not None:
                    command.report(result_of(command.head, "running", id=name))

    def _report_dropped(self) -> None:
        found = self._inbox.dropped()
        if found is not None:
            count, head = found
            why = f"{count} commands came faster than {1.0 / PACE:.0f} a second: newer ones took their place"
            self._on_result(result_of(head, "dropped", message=why, count=count))


def result_of(head: CommandHeader | None, phase: str, **more: Any) -> Result:
    """One message of /bridge/results on a trajectory: whose it was, and what became of it."""
    known = head or CommandHeader()
    stamp = {"sec": known.sec, "nanosec": known.nanosec}
    known_fields = {key: value for key, value in more.items() if value not in (None, "", ())}
    return {"topic": TRAJECTORY.name, "stamp": stamp, "frame_id": known.frame, "phase": phase, **known_fields}


def call_text(error: CallError) -> str:
    """Return why the daemon refuses, as text for ROS users; the bridge takes no other client's lease."""
    lease = error.parameters.get("lease")
    if error.name != "LeaseHeld" or not isinstance(lease, Mapping):
        return str(error)
    held = f"the lease is held by {lease.get('holder')}, which keeps it as long as it moves the robot"
    return f"{held}; none is taken by force from ROS: let that one end, then send it again"
