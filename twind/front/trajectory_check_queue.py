"""Queue of trajectory checks before the loop: one at a time, in slices, so that other calls go on.

Front process. The model is loaded once clients are served, in a thread; until then paths wait. The findings
travel with the path (`Submit.refused`, `Submit.warned`): the loop adds its own share and answers. A caller so
receives all findings at once.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from twind.front.client_calls import ClientCall
from twind.front.front_core import FrontCore
from twind.front.ticket_table import OUTSTANDING
from twind.link import RenewLease, Tick
from twind.robot.arrays import Floats
from twind.robot.event_codes import EventCode
from twind.robot.finding import Finding, ReasonCode, Verdict
from twind.robot.modes import Mode, Motion
from twind.robot.trajectory import Reference, Trajectory

if TYPE_CHECKING:
    from twind.twin.trajectory_precheck import TrajectoryPrecheck

Forward = Callable[[Verdict, float], None]  # what was found, and when the state that it rests on was true
KEPT = (
    10.0  # s that a path which waits here keeps its client's lease: on a slow machine the model loads as long
)
NOBODY = 0  # the ticket of a command without a waiting caller


@dataclass(slots=True)
class TrajectoryCheck:
    """One path to judge. `begun` is the state that it is judged from."""

    call: ClientCall
    path: Trajectory
    append_stop: bool
    moves: bool  # it will be followed if nothing is wrong; False: `Check`
    forward: Forward
    asked: float  # s, time of the call
    begun: Tick | None = None


class TrajectoryCheckQueue:
    """Queue of trajectory checks: the one under way and those that wait.

    One path of a connection at a time, in the order of its calls.
    """

    def __init__(self, front: FrontCore) -> None:
        self._front = front
        self._foresight: TrajectoryPrecheck | None = None
        self._why = "the model is not loaded"
        self._loaded = False
        self._jobs: deque[TrajectoryCheck] = deque()
        self._steps: Generator[None, None, Verdict] | None = None
        self.stops = 0  # of the robot, that clients have requested

    # ------------------------------------------------------------------------------- the model

    def load(self) -> None:
        """Begin to load the model. Answers of the front do not wait for it."""
        loading = self._front.loop.run_in_executor(None, self._load)
        loading.add_done_callback(lambda done: self._ready(done.result()))

    def replace(self, foresight: TrajectoryPrecheck) -> None:
        """Check paths with other limits from now on; paths begun or waiting must be sent again."""
        self._foresight = foresight
        self._loaded = True
        self._steps = None
        old = list(self._jobs)
        self._jobs.clear()  # first: with an answer the next call of its connection begins, maybe a path too
        for job in old:
            reason = "the limits were changed while this was judged: send it again"
            self._front.refuse(job.call, [Finding(ReasonCode.CMD_EXPIRED, message=reason)])

    def _load(self) -> TrajectoryPrecheck | None:
        """Load the model in a thread, because the import of MuJoCo takes a quarter of a second."""
        try:
            from twind.twin.binding_transfer import foresight  # noqa: PLC0415  status is served before MuJoCo is there

            briefing = self._front.world.briefing
            return foresight(briefing.binding, 1.0 / briefing.rate_hz)
        except Exception as error:  # noqa: BLE001  any failure: no look-ahead, and every path is refused
            self._why = f"{type(error).__name__}: {error}"
            return None

    def _ready(self, foresight: TrajectoryPrecheck | None) -> None:
        if not self._loaded:  # else the limits were changed meanwhile
            self._foresight = foresight
            self._loaded = True
        now = self._front.now()
        if self._foresight is None:
            self._front.log.write(
                "error", EventCode.LOOKAHEAD, now, message=f"none, no motion is accepted: {self._why}"
            )
        else:
            pairs = len(self._foresight.bodies.pairs)
            self._front.log.write(
                "info", EventCode.LOOKAHEAD, now, message=f"{pairs} pairs of bodies are watched"
            )
        self._next()

    # ------------------------------------------------------------------------------- paths

    def judge(self, job: TrajectoryCheck) -> None:
        """Judge a path when it is its turn, then forward it; a connection that is gone by then ends it."""
        own = [other for other in self._jobs if other.call.caller.number == job.call.caller.number]
        if len(own) >= OUTSTANDING:  # only `oneway` can come that far
            holder = job.call.caller.holder
            self._front.log.write("warning", EventCode.ONEWAY_FLOOD, self._front.now(), holder=holder)
            return
        self._jobs.append(job)
        self.keep()
        if len(self._jobs) == 1:
            self._next()

    def keep(self) -> None:
        """Renew the lease for paths still under check: a motion call renews it when it comes.

        Called with every heartbeat. The loop refuses it to a client that does not hold the lease.
        """
        since = self._front.now() - KEPT
        waiting = {
            job.call.caller.number: job.call.caller for job in self._jobs if job.moves and job.asked > since
        }
        for number, caller in waiting.items():
            if number in self._front.sessions:
                self._front.link.send(
                    RenewLease(ticket=NOBODY, client=number, uid=caller.uid, holder=caller.holder)
                )

    def stop(self) -> None:
        """Refuse the motions that are still being judged.

        The robot is stopped, and they must not begin afterwards. Nor those that wait for their turn: by
        `stops` their session tells that one came.
        """
        self.stops += 1
        stopped = [job for job in self._jobs if job.moves]
        if self._jobs and self._jobs[0].moves:
            self._steps = None
        for job in stopped:
            self._jobs.remove(job)
            reason = "the robot was stopped while this was judged: send it again"
            self._front.refuse(job.call, [Finding(ReasonCode.BUSY, message=reason)])
        if stopped and self._steps is None:
            self._front.loop.call_soon(self._next)

    def _next(self) -> None:
        """Begin with the first that waits."""
        if self._steps is not None or not self._loaded:
            return
        while self._jobs and self._jobs[0].call.caller.number not in self._front.sessions:
            self._jobs.popleft()
        if not self._jobs:
            return
        job = self._jobs[0]
        job.begun = self._front.world.tick
        if self._foresight is None or job.begun is None:
            reason = f"no look-ahead, so no motion is accepted: {self._why}"
            self._done(Verdict((Finding(ReasonCode.SELF_COLLISION, message=reason),)))
            return
        reference = standing(job.begun)
        self._steps = self._foresight.judging(job.path, reference, append_stop=job.append_stop)
        self._front.loop.call_soon(self._step)

    def _step(self) -> None:
        """Run one slice of a check; then other clients are served."""
        if self._steps is None:
            return
        if self._jobs[0].call.caller.number not in self._front.sessions:  # its client is gone
            self._steps = None
            self._next()
            return
        try:
            next(self._steps)
        except StopIteration as stop:
            self._done(stop.value)
        except Exception as error:  # noqa: BLE001  a path that breaks the judgement is not forwarded
            call = self._jobs[0].call
            self._front.broken(call.caller, call.method, error)
            reason = f"cannot be judged: {type(error).__name__}: {error}"
            self._done(Verdict((Finding(ReasonCode.SELF_COLLISION, message=reason),)))
        else:
            self._front.loop.call_soon(self._step)

    def _done(self, verdict: Verdict) -> None:
        job = self._jobs.popleft()
        self._steps = None
        try:
            job.forward(verdict, self._as_of(job.begun))
        except (OSError, MemoryError) as error:  # a path travels in a descriptor of its own
            job.call.error("Busy", {"what": f"out of descriptors or memory: {error}"})
        finally:
            self._front.loop.call_soon(self._next)

    def _as_of(self, begun: Tick | None) -> float:
        """Return the time (s) of the state under a verdict: now, if the robot has held since it began."""
        now = self._front.world.tick
        if begun is None or now is None:
            return self._front.now() if begun is None else begun.time
        holds = (begun.motion, now.motion) == (Motion.HOLDING, Motion.HOLDING)
        return now.time if holds and now.goal == begun.goal else begun.time


def standing(tick: Tick) -> Reference:
    """Return where a path begins: at the goal, else at the position of the commanded target. NaN: unknown."""
    goal = _floats(tick.goal)
    place = _floats(tick.position if tick.mode == Mode.LIVE else tick.simulated)
    still = np.zeros(len(goal))
    return Reference(np.where(np.isfinite(goal), goal, place), still, still)


def _floats(data: bytes) -> Floats:
    return np.frombuffer(data, np.float64)
