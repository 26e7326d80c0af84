"""Commands from ROS: topics, services and goals as requests of `twind.bridge.commands`. Library, Python 3.10.

Arming is not among them: it requires an operator beside the robot.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from twind.bridge.commands.leased_motions import LeasedMotions, MotionRequest, refusal
from twind.bridge.commands.request_queue import RequestQueue
from twind.bridge.commands.stop_queues import CUT, HOLD, SETTLE, Connect, Outcome, StopQueues, Tell, call
from twind.bridge.ros.ros_endpoints import (
    E_STOP,
    GET_STATUS,
    SET_LIVE,
    SET_MODE,
    STOP,
    TO_E_STOP,
    TO_MODE,
    TO_STOP,
    TRAJECTORY,
    RosService,
    RosTopic,
)
from twind.bridge.ros.ros_trajectory import LONGEST, CommandHeader, heading, trajectory
from twind.bridge.ros.ros_transport import Reply
from twind.client import CallError, ClientError, Refused
from twind.exceptions import InvalidInput
from twind.ros import STRING, decode

SOON = 2.0  # s for an answer that waits for nothing
REASON = "requested over ROS"
STOPPING = "stopping: the robot decelerates and holds"
ROOM = 8  # trajectories that wait
PACE = 1.0 / 15.0  # s between two of them: the daemon refuses more than 20 a second
MODE_PACE = 1.0  # s from one mode to the next
MODE_PATIENCE = 35.0  # s for the answer to a mode or a setting
STOP_PACE = 0.1  # s from one hold to the next; an e-stop has none
PATIENT = 1.0  # s that a command may wait: what was meant for then is not done later
STEP = 0.1  # s between two looks at the motions
DROPS = 1.0  # s between two reports of commands that were dropped
MORE = 64 << 10  # bytes of JSON that tolerances may take beside a path

Result = Mapping[str, Any]
Results = Callable[[Result], None]


@dataclass(frozen=True, eq=False, slots=True)
class RosRequest:
    """Request of a topic or a service. `reply` gets the outcome."""

    parameters: Mapping[str, Any]
    reply: Callable[[Outcome], None]
    by_topic: bool = False


class RosMotion:
    """Trajectory of a topic or an action, by its header (None: malformed).

    `followed`: its sender waits for reports, so no newer command takes its place.
    """

    request: MotionRequest

    def __init__(self, head: CommandHeader | None, followed: bool) -> None:
        self.head = head
        self.followed = followed

    def voids(self, older: RosMotion) -> bool:
        """Return True if following this command leaves nothing of the other, which came before it."""
        new = self.head
        old = older.head
        if new is None or old is None or older.followed or older.request.came > self.request.came:
            return False
        return new.time_ns == old.time_ns == 0 and set(new.joints) >= set(old.joints)


def _next_motion(waiting: Sequence[RosMotion]) -> Sequence[RosMotion]:
    """Return the oldest command, or the newest that leaves nothing of it.

    If that is accepted, the older ones are dropped; if it is refused, they stay valid.
    """
    chosen = waiting[0]
    for newer in waiting:
        chosen = newer if newer.voids(chosen) else chosen
    return [chosen]


class RosCommands:
    """Commands of one graph. `motions`: needs the answers of `Monitor`.

    `on_message`, `on_request` and `goal` return at once, from any thread.
    """

    def __init__(
        self,
        operator: Connect,
        observer: Connect,
        *,
        status: Callable[[Outcome], str],
        closed: Callable[[bool], str],
        on_result: Results,
        tell: Tell,
        wall_ns: Callable[[], int] = time.time_ns,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        """Make the commands; `operator` and `observer` make connections.

        `status`: text of /bridge/status from the daemon's answer or error. `closed`: why no hold (True), or
        no other command is taken; "": it is. `on_result` gets the results of topics, `tell` defects.
        `wall_ns`: clock of the stamps, ns since 1970.
        """
        self._operator = operator
        self._observer = observer
        self._status = status
        self._closed = closed
        self._on_result = on_result
        self._wall_ns = wall_ns
        self._now = now
        self.motions = LeasedMotions(operator, now)
        self._dropping = threading.Lock()
        self._dropped = 0
        self._last_dropped = CommandHeader()
        self._drops_reported = float("-inf")
        hold_closed = partial(closed, True)
        self.stops = StopQueues(
            operator, observer, self.motions.stopped, tell, closed=hold_closed, hold_pace=STOP_PACE
        )
        self._modes = RequestQueue[RosRequest]("mode", self._set_mode, tell, length=ROOM, pace=MODE_PACE)
        self._asking = RequestQueue[Reply]("status", self._answer_status, tell, choose=list)
        self.trajectories = RequestQueue[RosMotion](
            "trajectories",
            lambda motions: self.motions.take(motions[0].request),
            tell,
            length=ROOM,
            pace=PACE,
            newest=True,
            choose=_next_motion,
            tend=self.keep,
            period=STEP,
            last=self.motions.close,
        )
        self._by_topic = {
            kind: RosRequest({"reason": REASON}, partial(self._report_stop, kind), by_topic=True)
            for kind in (SETTLE, CUT, HOLD)
        }

    def start(self) -> None:
        """Start all queues."""
        for queue in self.stops.queues.values():
            queue.start()
        self._modes.start()
        self._asking.start()
        self.trajectories.start()

    def stop(self, patience: float) -> None:
        """Begin nothing more, and give the lease back; return after `patience` s at the latest."""
        self.motions.stopped(self._now())
        self.trajectories.stop(patience)

    # ------------------------------------------------------------------------------------------ stops, modes

    def on_message(self, topic: RosTopic, data: bytes) -> None:
        """Handle a message of a topic. An invalid one changes no mode, but any stop message stops."""
        if topic is TRAJECTORY:
            self._put(data, None, {})
            return
        try:
            text = str(decode(STRING, data)["data"]).strip()
        except InvalidInput:
            text = ""
        if topic is E_STOP:
            self.stops.put(CUT if text == CUT else SETTLE, self._by_topic[CUT if text == CUT else SETTLE])
        elif topic is STOP:
            self.stops.put(HOLD, self._by_topic[HOLD])
        else:
            mode = text[:80]
            request = RosRequest({"mode": mode}, partial(self._report, SET_MODE, mode), by_topic=True)
            self._modes.remove(lambda older: older.by_topic)  # of a flood the last one wins
            self._modes.put(request)

    def on_request(self, service: RosService, data: bool | None, reply: Reply) -> None:
        """Handle a request of a service. Its reply has a text for ROS users."""

        def on_outcome(outcome: Outcome) -> None:
            reply(*_as_text(outcome, stopping=service is TO_STOP))

        if service is GET_STATUS:
            room = self._asking.put(reply) is not None
        elif service is TO_STOP or service is TO_E_STOP:
            kind = HOLD if service is TO_STOP else SETTLE
            room = self.stops.put(kind, RosRequest({"reason": REASON}, on_outcome))
        else:
            modes = {known: mode for mode, known in TO_MODE.items()}
            mode = modes[service] if service is not SET_LIVE else "live" if data else "mirror"
            room = self._modes.put(RosRequest({"mode": mode}, on_outcome)) is not None
        if not room:
            reply(False, f"{service.name}: too many requests wait; send it again")

    def settings(self, changes: Mapping[str, Any]) -> Outcome:
        """Return the daemon's settings, after these changes. Waits for the daemon; from any thread."""
        if not changes:
            return call((self._observer,), "GetParameters", SOON, {})
        why = self._closed(False)
        if why:
            return ClientError(why)
        return call((self._operator,), "SetParameters", MODE_PATIENCE, {"parameters": changes})

    def _answer_status(self, replies: Sequence[Reply]) -> None:
        text = self._status(call((self._observer,), "GetStatus", SOON, {}))
        for reply in replies:
            reply(True, text)

    def _set_mode(self, requests: Sequence[RosRequest]) -> None:
        (request,) = requests
        why = self._closed(False) if request.parameters["mode"] else "malformed: name a mode in a String"
        asked = request.parameters
        request.reply(ClientError(why) if why else call((self._operator,), "SetMode", MODE_PATIENCE, asked))

    def _report_stop(self, kind: str, outcome: Outcome) -> None:
        if kind == HOLD:
            self._report(STOP, "", outcome)
        else:
            self._report(E_STOP, kind, outcome)

    def _report(self, topic: RosTopic, asked: str, outcome: Outcome) -> None:
        done, message = _as_text(outcome, stopping=topic is STOP)
        phase = "done" if done else "refused"
        self._on_result({"topic": topic.name, "asked": asked, "phase": phase, "message": message})

    # ------------------------------------------------------------------------------------------ trajectories

    def goal(
        self,
        data: bytes,
        report: Results,
        *,
        goal_time: float | None = None,
        tolerances: Sequence[Mapping[str, Any]] | None = None,
    ) -> Callable[[], None]:
        """Queue a trajectory with a receiver: `report` gets each `phase`.

        The returned function cancels it: all holds.
        """
        given = {"goal_time": goal_time, "tolerances": tolerances}
        motion = self._put(data, report, {key: value for key, value in given.items() if value is not None})
        return partial(self.motions.withdraw, motion.request)

    def _put(self, data: bytes, receiver: Results | None, more: Mapping[str, Any]) -> RosMotion:
        head = heading(data)
        came = self._now()
        motion = RosMotion(head, receiver is not None)
        motion.request = MotionRequest(
            partial(self._trajectory, data[: LONGEST + 1], came, more),
            partial(self._report_motion, motion, receiver),
            came,
            self._objection,
        )
        self._drop(self.trajectories.put(motion) or ())
        return motion

    def _drop(self, motions: Sequence[RosMotion]) -> None:
        """Report dropped commands: at once to those who wait for it, else their number, later."""
        for each in motions:
            if each.followed:
                error = ClientError(f"more than {ROOM} commands wait: send it again")
                each.request.report("refused", {"error": error})
                continue
            with self._dropping:
                self._dropped += 1
                self._last_dropped = each.head or CommandHeader()

    def _objection(self) -> ClientError | None:
        why = self._closed(False)
        return ClientError(why) if why else None

    def _trajectory(self, data: bytes, came: float, more: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return the daemon's Trajectory. Raises Refused, also for a command that is too old."""
        waited = self._now() - came
        if waited > PATIENT:
            why = f"waited {waited:.1f} s here, at most {PATIENT:g}: send it again"
            raise refusal("CMD_EXPIRED", why, value=waited, bound=PATIENT)
        size = len(json.dumps(more))
        if size > MORE:
            raise refusal("FRAME_TOO_LARGE", f"tolerances of {size} bytes: must be at most {MORE}")
        return {**trajectory(data, self._wall_ns()), **more}

    def _report_motion(
        self, motion: RosMotion, receiver: Results | None, phase: str, fields: Mapping[str, Any]
    ) -> None:
        if phase == "accepted":
            self._drop(self.trajectories.remove(motion.voids))
        result = _motion_result(motion.head, phase, fields)
        if phase != "running":
            self._on_result(result)
        if receiver is not None:
            receiver(result)

    def keep(self) -> None:
        """Report ends and drops; in the thread of the trajectories."""
        self.motions.keep()
        now = self._now()
        if now - self._drops_reported < DROPS:
            return
        with self._dropping:
            count = self._dropped
            self._dropped = 0
        if count:
            self._drops_reported = now
            why = f"{count} commands came faster than {1.0 / PACE:.0f} a second: newer ones took their place"
            self._on_result(_result_of(self._last_dropped, "dropped", message=why, count=count))


def _motion_result(head: CommandHeader | None, phase: str, fields: Mapping[str, Any]) -> Result:
    if phase == "accepted":
        answer = fields["answer"]
        verdict = answer.get("verdict") or {}
        more = {key: verdict[key] for key in ("warnings", "changes") if verdict.get(key)}
        return _result_of(head, phase, id=answer["id"], **more)
    error = fields.get("error")
    if error is not None:
        return _result_of(head, phase, message=error_text(error), **_error_fields(error))
    findings = fields.get("findings") or ()
    message = "; ".join(str(each.get("message", "")) for each in findings)
    return _result_of(head, phase, id=fields.get("id"), message=message, findings=findings)


def _error_fields(error: ClientError) -> dict[str, Any]:
    if isinstance(error, Refused):
        return {"findings": error.findings}
    if isinstance(error, CallError):
        return {"error": error.name}
    return {} if type(error) is ClientError else {"error": type(error).__name__}


def _result_of(head: CommandHeader | None, phase: str, **more: Any) -> Result:
    """One message of /bridge/results on a trajectory: whose it was, and what became of it."""
    known = head or CommandHeader()
    stamp = {"sec": known.sec, "nanosec": known.nanosec}
    known_fields = {key: value for key, value in more.items() if value not in (None, "", ())}
    return {"topic": TRAJECTORY.name, "stamp": stamp, "frame_id": known.frame, "phase": phase, **known_fields}


def _as_text(outcome: Outcome, *, stopping: bool) -> tuple[bool, str]:
    """Return success and a text for ROS users."""
    if isinstance(outcome, ClientError):
        return False, error_text(outcome)
    if stopping:
        return True, STOPPING  # the state in the answer does not include the motion
    return True, str(outcome.get("mode") or outcome.get("state") or "")


def error_text(error: ClientError) -> str:
    """Return why the daemon refuses, in one line for ROS users; the bridge takes no other client's lease."""
    lease = error.parameters.get("lease") if isinstance(error, CallError) else None
    if not isinstance(lease, Mapping):
        return "; ".join(str(error).splitlines())
    held = f"the lease is held by {lease.get('holder')}, which keeps it as long as it moves the robot"
    return f"{held}; none is taken by force from ROS: let that one end, then send it again"


def result_line(result: Result) -> str:
    """Format `/cmd/joint_trajectory from 'mine': refused: POS_LIMIT: ...`."""
    who = f" from {result['frame_id']!r}" if result.get("frame_id") else ""
    request = f" {result['asked']}" if result.get("asked") else ""
    name = f" {result['id']}" if result.get("id") else ""
    why = f": {str(result['message'])[:500]}" if result.get("message") else ""
    return f"{result['topic']}{request}{who}: {result['phase']}{name}{why}"
