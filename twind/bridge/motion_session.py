"""Motion session of a bridge: the lease, trajectories sent under it, their ends. Standard library, 3.10.

It uses a connection of its own. That is opened for a trajectory, renews the lease while one of them is under
way, and is closed soon after the last has ended, so that other clients may command. If the holder dies, the
daemon holds the robot. Trajectories go without `more`, so that a newer one replaces the older. `Monitor`
reports on another connection how each ends (`on_monitor_reply`).
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf
from typing import Any

from twind.client import Client, ClientError, Refused

PATIENCE = 15.0  # s for a verdict: the front may take 10 to judge a long path
SOON = 2.0  # s for all other answers
RENEW = 0.3  # s between two renewals of a lease that lasts 1
LINGER = 0.5  # s after the last motion until the lease is given back
LATE = 1.0  # s without motion after which one counts as ended; else it would keep the lease for ever
EARLY = 64  # ends kept of unknown motions: an end may arrive before the answer that names the motion
MOVING = ("active", "streaming")  # of `Status.motion`
STOPPED = ("cancelled", "aborted")  # ends after which the robot is not where its sender expects it
ENDS = ("succeeded", "replaced", *STOPPED)
# Codes of `twind.robot`, whose enumerations need Python 3.11
MOTION = "MOTION"
LEASE_LOST = "LEASE_LOST"

LOST = "lost"  # phase of an end that was not received, or cannot be read

BROKEN = ({"code": LEASE_LOST, "message": "the connection to the daemon broke: it lets go of such motions"},)
UNREADABLE = (
    {
        "code": "INTERNAL",
        "message": "the daemon reported an end with a phase unknown to this bridge: restart both, so that "
        "their versions are the same",
    },
)


@dataclass(frozen=True, slots=True)
class MotionEnd:
    """End of a motion. `phase`: succeeded, cancelled, replaced, aborted, or lost (the end is unknown)."""

    id: str
    phase: str
    findings: Sequence[Mapping[str, Any]] = ()

    @property
    def stopped(self) -> bool:
        """The robot is not where the sender of the motion expects it."""
        return self.phase in (*STOPPED, LOST)


def reported_end(answer: Mapping[str, Any]) -> MotionEnd | None:
    """The end of a motion that this answer of `Monitor` reports; None: it reports none.

    An end whose phase is missing (older daemons) or unknown is LOST. Its id is then "" where the daemon gives
    none: any motion may have ended, so every motion is over. Streamed setpoints end with id "" as well.
    """
    if answer["topic"] != "events" or answer["event"]["code"] != MOTION:
        return None
    event = answer["event"]
    name = event.get("id") or ""
    phase = event.get("phase")
    return MotionEnd(name, phase, event["findings"]) if phase in ENDS else MotionEnd(name, LOST, UNREADABLE)


@dataclass(slots=True)
class _Motion:
    begins: float  # s, monotonic
    orphaned: float = inf  # s, when the connection broke that it was sent on


class MotionSession:
    """Motion session. Any thread may call `on_monitor_reply`, `driving` and `cut`, one thread all else.

    `held`: `hold` has requested the lease, and no loss of it is known.
    """

    def __init__(self, operator: Callable[[], Client], now: Callable[[], float] = time.monotonic) -> None:
        """Make the session; `operator` makes a connection with the operator's rights. `now`: s, monotonic.

        The connection need not be open.
        """
        self._operator = operator
        self._now = now
        self._client: Client | None = None
        self.held = False
        self._renewed = self._quiet = -inf  # s, time of the last request, and of the end of the last motion
        self._still = inf  # s, time since when nothing moves, by the statuses
        self._lock = threading.Lock()
        self._under: dict[str, _Motion] = {}
        self.finished: dict[str, MotionEnd] = {}  # received, and not returned by `keep` yet
        self._let_go = False  # an end came that cannot be read: what is under way must not go on

    @property
    def driving(self) -> tuple[str, ...]:
        """Motions that are under way or wait for their start."""
        with self._lock:
            return tuple(self._under)

    def hold(self) -> None:
        """Take the lease and keep it until `close`, with or without motion.

        Raises ClientError: LeaseHeld by another client, NoDaemon.
        """
        client = self._connected(SOON)
        try:
            client.call("AcquireLease")
        except ClientError:
            self.close()
            raise
        self.held = True
        self._renewed = self._now()

    def submit(self, trajectory: Mapping[str, Any]) -> Mapping[str, Any]:
        """Submit a trajectory; return the answer `accepted`, with its id and verdict.

        Raises ClientError: Refused by the gate, LeaseHeld by another client, NoDaemon.
        """
        client = self._connected(PATIENCE)
        try:
            client.call("AcquireLease")
            answer = client.call("SubmitTrajectory", trajectory=trajectory)
            name = str(answer["id"])
        except ClientError:
            if not client.connected:
                self._lose()
            elif not self.driving and not self.held:  # a refused client must not keep the lease from others
                self.close()
            raise
        except Exception:  # whether the motion runs is unknown: losing the lease ends it
            self._lose()
            raise
        finally:
            self._renewed = self._now()
        self._quiet = self._renewed
        with self._lock:
            self._under[name] = _Motion(self._renewed + (trajectory.get("start_in") or 0.0))
        return answer

    def keep(self) -> list[MotionEnd]:
        """Return the motions that ended since; renew the lease, or give it back without motion.

        Call it often.
        """
        now = self._now()
        over = self._take_ended_motions()
        if self._let_go:
            self.close()
        elif self.driving or self.held:
            self._quiet = now
            if now - self._renewed >= RENEW:
                self._renewed = now
                self._renew()
        elif now - self._quiet >= LINGER:
            self.close()
        return over

    def on_monitor_reply(self, answer: Mapping[str, Any]) -> None:
        """Take an answer of `Monitor`: events report ends, a status whether anything still moves."""
        ended = reported_end(answer)
        if ended is not None and ended.phase == LOST and not ended.id:
            self._end_all(ended)
        elif ended is not None:
            self._end(ended)
        elif answer["topic"] == "status":
            self._look(still=answer["status"]["motion"] not in MOVING)

    def close(self) -> None:
        """Give the lease back and hang up: what is under way decelerates and holds. May be called twice."""
        if self._client is not None and self._client.connected:
            self._client.timeout = SOON
            with contextlib.suppress(ClientError, RuntimeError):
                self._client.call("ReleaseLease")
        self._lose()

    def cut(self) -> None:
        """Hang up though another thread waits for an answer: the lease ends, the daemon holds what moves."""
        client = self._client
        if client is not None:
            client.cut()

    # ------------------------------------------------------------------------------------------ inside

    def _connected(self, patience: float) -> Client:
        if self._client is None:
            self._client = self._operator()
        self._client.timeout = patience
        return self._client

    def _end(self, ended: MotionEnd) -> None:
        with self._lock:
            self.finished.setdefault(ended.id, ended)
            unknown = [name for name in self.finished if name not in self._under]
            for name in unknown[: max(0, len(unknown) - EARLY)]:
                del self.finished[name]

    def _end_all(self, ended: MotionEnd) -> None:
        """End all motions of this session, since it is unknown which one ended.

        `keep` gives the lease back.
        """
        with self._lock:
            names = tuple(self._under)
            self._let_go = True
        for name in names:
            self._end(replace(ended, id=name))

    def _look(self, *, still: bool) -> None:
        """End motions without report: nothing has moved for longer than any of them may wait."""
        now = self._now()
        with self._lock:
            if not still:
                self._still = inf
                return
            self._still = min(self._still, now)  # an end is reported after the status that shows it
            late = now - LATE
            gone = [name for name, motion in self._under.items() if max(motion.begins, self._still) < late]
        for name in gone:
            self._end(MotionEnd(name, LOST))

    def _take_ended_motions(self) -> list[MotionEnd]:
        """Return the ends of this session's motions, each once."""
        late = self._now() - LATE
        with self._lock:
            for name, motion in self._under.items():
                if motion.orphaned < late:
                    self.finished.setdefault(name, MotionEnd(name, LOST, BROKEN))
            names = [name for name in self._under if name in self.finished]
            for name in names:
                del self._under[name]
            return [self.finished.pop(name) for name in names]

    def _renew(self) -> None:
        if self._client is None:
            return
        self._client.timeout = SOON
        try:
            self._client.call("RenewLease")
        except Refused:  # taken or lapsed: that has ended the motion, and the event reports it
            self.held = False
        except ClientError:
            self._lose()

    def _lose(self) -> None:
        """Drop the connection and with it the lease: the daemon, if it runs, holds the robot."""
        if self._client is not None:
            self._client.close()
        self._client = None
        self.held = False
        now = self._now()
        with self._lock:
            self._let_go = False
            for motion in self._under.values():
                motion.orphaned = min(motion.orphaned, now)
