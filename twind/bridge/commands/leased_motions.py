"""Trajectories from elsewhere under the daemon's lease, each reported to its end. Library, Python 3.10.

One connection has the lease: made for a trajectory or by `hold`, given up soon after the last motion, so that
other clients may command. If this process dies, the daemon holds the robot. Trajectories go without `more`,
so that a newer one replaces the older; `Monitor` reports on another connection how each ends.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from math import inf
from typing import Any

from twind.bridge.commands.motion_end import (
    BRIDGE_ENDED,
    BROKEN,
    BUSY,
    LEASE_LOST,
    LOST,
    UNREPORTED,
    MotionEnd,
    reported_end,
)
from twind.client import Client, ClientError
from twind.client.errors import CallError, as_error
from twind.robot_client.leased_connection import LeasedConnection

PATIENCE = 15.0  # s for a verdict: the front may take 10 to judge a long path
SOON = 2.0  # s for all other answers
LINGER = 0.5  # s after the last motion until the lease is given back
LATE = 1.0  # s without motion after which one counts as ended; else it would keep the lease for ever
EARLY = 64  # ends kept of unknown motions: an end may arrive before the answer that names the motion
RUNNING = 0.15  # s between two reports of a motion that goes on
MOVING = ("active", "streaming")  # of `Status.motion`

Report = Callable[[str, Mapping[str, Any]], None]


def refusal(code: str, message: str, **more: Any) -> CallError:
    """Return a refusal with one finding, in the form of the gate's."""
    empty = dict.fromkeys(("joint", "point", "time", "value", "bound"))
    findings = [{"code": code, **empty, **more, "message": message}]
    return as_error("io.twind.Control.Refused", {"findings": findings})


@dataclass(eq=False, slots=True)
class MotionRequest:
    """One trajectory that a sender wants to run.

    `trajectory` makes the daemon's Trajectory when its turn has come; it may raise ClientError. `report` gets
    each phase with its fields: `accepted` (`answer`), `refused` (`error`), `running`, an end (`findings`).
    `came`: s, monotonic, when it arrived. `objection`: why it may not begin now; asked before and after the
    gate.
    """

    trajectory: Callable[[], Mapping[str, Any]]
    report: Report
    came: float
    objection: Callable[[], ClientError | None] = lambda: None
    withdrawn: bool = False


@dataclass(eq=False, slots=True)
class _Motion:
    request: MotionRequest
    begun: float  # s, monotonic, when it was accepted
    begins: float  # s, monotonic
    orphaned: float = inf  # s, when the connection broke that it was sent on


@dataclass(slots=True)
class _DaemonNews:
    """Reports of `Monitor`, and motions that this bridge cancelled itself."""

    ends: dict[str, MotionEnd] = field(default_factory=dict)  # not returned by `LeasedMotions.keep` yet
    released: set[str] = field(default_factory=set)  # motions that this bridge ends: no stop by others
    stopped: float = -inf  # s, monotonic: what arrived until then is void
    still: float = inf  # s, time since when nothing moves
    mode: str = ""
    mode_at: float = -inf
    unreadable: bool = False  # what is under way must not go on


class LeasedMotions:
    """Motions of one daemon. One thread calls `take`, `hold`, `release`, `keep` and `close`.

    Any thread may call all else.
    """

    def __init__(self, operator: Callable[[], Client], now: Callable[[], float] = time.monotonic) -> None:
        """Make it; `operator` makes a connection that may command, not necessarily open."""
        self._operator = operator
        self._now = now
        self._connection: LeasedConnection | None = None
        self._connected_at = inf  # s
        self._taken = False  # the lease, by another client
        self._kept = False  # without motion too
        self._quiet = self._reported = -inf  # s, end of the last motion, and last report of those that run
        self._lock = threading.Lock()
        self._motions: dict[str, _Motion] = {}
        self._news = _DaemonNews()

    @property
    def moving(self) -> tuple[str, ...]:
        """Motions that are under way or wait for their start."""
        with self._lock:
            return tuple(self._motions)

    @property
    def held(self) -> bool:
        """True if this object has the daemon's lease and knows of no loss."""
        connection = self._connection
        if connection is None or self._taken or not connection.leased:
            return False
        return connection.client.connected and not connection.client.is_hung_up()

    def take(self, request: MotionRequest) -> None:
        """Take a request to the gate, and report the verdict."""
        make = request.trajectory
        request.trajectory = dict  # it may be long, and a motion too
        if request.withdrawn:
            request.report("cancelled", {})
            return
        void = self._void(request)
        if void is not None:
            request.report("refused", {"error": void})
            return
        try:
            trajectory = make()
            answer = self._submit(trajectory)
        except CallError as error:
            if BUSY in {each["code"] for each in getattr(error, "findings", ())}:
                self.stopped(self._now())  # the gate drops paths at a stop: none that waits begins after it
            request.report("refused", {"error": error.with_traceback(None)})  # its frames have the path
        except ClientError as error:
            request.report("refused", {"error": self._void(request) or error.with_traceback(None)})
        except Exception as error:  # noqa: BLE001  the sender gets a report of any failure
            request.report("refused", {"error": ClientError(f"{type(error).__name__}: {error}")})
        else:
            self._accept(request, answer, trajectory.get("start_in") or 0.0)

    def hold(self) -> None:
        """Take the lease and keep it until `release`, with or without motion.

        Raises ClientError: LeaseHeld by another client, NoDaemon.
        """
        connection = self._connected(SOON)
        try:
            connection.command("RenewLease")
        except ClientError:
            self.release()
            raise
        self._kept = True

    def release(self) -> None:
        """Give the lease back and hang up: what is under way decelerates and holds. May be called twice."""
        now = self._now()
        held = self.held
        with self._lock:
            if held:  # else the end of a motion is the work of another client, or of the daemon
                self._news.released.update(self._motions)
            self._news.unreadable = False
            for motion in self._motions.values():
                motion.orphaned = min(motion.orphaned, now)
        if self._connection is not None:
            self._connection.client.timeout = SOON
            self._connection.close()
        self._connection = None
        self._kept = False

    def keep(self) -> None:
        """Report the motions that ended and those that run; give the lease back without motion.

        Call it often.
        """
        now = self._now()
        if self._connection is not None and not self.held:
            self.release()
        self._cancel_void()
        for motion, end in self._take_ends(now):
            motion.request.report(end.phase, {"id": end.id, "findings": end.findings})
        if self._news.unreadable:
            self.release()
        elif self.moving or self._kept:
            self._quiet = now
        elif self._connection is not None and now - self._quiet >= LINGER:
            self.release()
        if now - self._reported >= RUNNING:
            self._reported = now
            with self._lock:
                running = list(self._motions.items())
            for name, motion in running:
                motion.request.report("running", {"id": name})

    def close(self) -> None:
        """Release the lease, and report what was under way as cancelled."""
        self.release()
        with self._lock:
            motions = dict(self._motions)
            self._motions.clear()
        for name, motion in motions.items():
            motion.request.report("cancelled", {"id": name, "findings": BRIDGE_ENDED})

    # ------------------------------------------------------------------------------------------ any thread

    def stopped(self, at: float) -> None:
        """Record a stop of the robot at `at`, s, monotonic: nothing that arrived until then begins."""
        with self._lock:
            self._news.stopped = max(self._news.stopped, at)

    def withdraw(self, request: MotionRequest) -> None:
        """Cancel a request, before it begins or while it runs: then everything decelerates and holds."""
        with self._lock:
            running = any(motion.request is request for motion in self._motions.values())
        if not (running and self._cancel()):
            request.withdrawn = True

    def cut(self) -> None:
        """Hang up though another thread waits for an answer: the lease ends, the daemon holds what moves."""
        connection = self._connection
        if connection is not None:
            with self._lock:
                self._news.released.update(self._motions)
            connection.client.cut()

    def on_monitor_reply(self, answer: Mapping[str, Any]) -> None:
        """Take an answer of `Monitor`, topics events and status: ends, and stops by other clients."""
        ended = reported_end(answer)
        if ended is not None:
            self._note_end(ended, answer["time"])
        elif answer["topic"] == "events" and answer["event"]["code"] == LEASE_LOST:
            self.stopped(answer["time"])
            self._taken = self._taken or answer["time"] > self._connected_at
        elif answer["topic"] == "status":
            self._note_status(answer["status"], answer["time"])

    # ------------------------------------------------------------------------------------------ the gate

    def _void(self, request: MotionRequest) -> ClientError | None:
        """Return why the request must not move anything; None: it may."""
        with self._lock:
            void = request.came <= self._news.stopped
        if void:
            return refusal(BUSY, "the robot was stopped after this was sent: send it again")
        return request.objection()

    def _submit(self, trajectory: Mapping[str, Any]) -> Mapping[str, Any]:
        if self._connection is not None and not self.held:
            self.release()
        connection = self._connected(PATIENCE)
        try:
            answer = connection.command("SubmitTrajectory", trajectory=trajectory)
            return {**answer, "id": str(answer["id"])}
        except CallError:
            if not self.moving and not self._kept:  # a refused client must not keep the lease from others
                self.release()
            raise
        except Exception:  # whether the motion runs is unknown: losing the lease ends it
            self.release()
            raise
        finally:
            self._quiet = self._now()

    def _accept(self, request: MotionRequest, answer: Mapping[str, Any], start_in: float) -> None:
        """Record an accepted motion, unless it was stopped while it was judged.

        One whose end is known already has begun: its end says why, and there is nothing left to cancel.
        """
        now = self._now()
        error = self._void(request)
        with self._lock:
            self._motions[answer["id"]] = _Motion(request, now, now + start_in)
            ended = self._is_over(answer["id"])
        if error is None or ended:
            request.report("accepted", {"answer": answer})
            return
        if not self._cancel():
            self.release()
        with self._lock:
            self._motions.pop(answer["id"], None)
        request.report("refused", {"error": error})

    def _is_over(self, name: str) -> bool:
        """Check that the end of a motion was reported; one whose end cannot be read may go on."""
        end = self._news.ends.get(name)
        return end is not None and end.phase != LOST

    def _connected(self, patience: float) -> LeasedConnection:
        if self._connection is None:
            self._connection = LeasedConnection(self._operator())
            self._connected_at = self._now()
            self._taken = False
        self._connection.client.timeout = patience
        return self._connection

    def _cancel_void(self) -> None:
        """Cancel what its sender withdrew, and what began after a stop that it came before."""
        with self._lock:
            time = self._news.stopped
            due = [
                each
                for name, each in self._motions.items()
                if not self._is_over(name)
                and (each.request.withdrawn or each.request.came <= time <= each.begun)
            ]
        for each in due:
            each.request.withdrawn = False
            each.begun = -inf
        if due and not self._cancel():
            self.release()

    def _cancel(self) -> bool:
        """Decelerate and hold, on a connection of its own, so that no path that is judged is before it."""
        with self._lock:
            self._news.released.update(self._motions)
        try:
            with self._operator() as client:
                client.timeout = SOON
                client.call("Cancel")
        except ClientError:
            return False
        return True

    # ------------------------------------------------------------------------------------------ ends

    def _note_end(self, ended: MotionEnd, at: float) -> None:
        with self._lock:
            if ended.phase == LOST and not ended.id:
                self._news.unreadable = True
                for name in self._motions:
                    self._news.ends.setdefault(name, replace(ended, id=name))
            else:
                self._news.ends.setdefault(ended.id, ended)
            if ended.stopped and ended.id not in self._news.released:
                self._news.stopped = max(self._news.stopped, at)
            self._news.released.discard(ended.id)
            unknown = [name for name in self._news.ends if name not in self._motions]
            for name in unknown[: max(0, len(unknown) - EARLY)]:
                del self._news.ends[name]

    def _note_status(self, status: Mapping[str, Any], at: float) -> None:
        """Void what was requested for another mode; end motions without report where nothing moves."""
        now = self._now()
        with self._lock:
            news = self._news
            if news.mode and status["mode"] != news.mode:
                news.stopped = max(news.stopped, news.mode_at)  # it was another one after that
            news.mode = status["mode"]
            news.mode_at = at
            if status["motion"] in MOVING:
                news.still = inf
                return
            news.still = min(news.still, now)  # an end is reported after the status that shows it
            for name, motion in self._motions.items():
                if max(motion.begins, news.still) < now - LATE:
                    news.ends.setdefault(name, MotionEnd(name, LOST, UNREPORTED))

    def _take_ends(self, now: float) -> list[tuple[_Motion, MotionEnd]]:
        """Return the motions that ended, each once."""
        with self._lock:
            ends = self._news.ends
            for name, motion in self._motions.items():
                if motion.orphaned < now - LATE:
                    ends.setdefault(name, MotionEnd(name, LOST, BROKEN))
            names = [name for name in self._motions if name in ends]
            self._news.released.difference_update(names)
            return [(self._motions.pop(name), ends.pop(name)) for name in names]
