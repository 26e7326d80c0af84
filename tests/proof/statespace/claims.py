"""Claims that hold after every step. Judged by the devices, the requests and what was ordered."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from twind.loop.procedures.procedure_runner import Priority
from twind.robot.finding import ReasonCode
from twind.robot.modes import Motion, RobotState
from twind.safety.state_machine import LATCHED

if TYPE_CHECKING:
    from tests.proof.statespace.world import ModelWorld

_S = RobotState
STOPPED = (*LATCHED, _S.INHIBITED)
AWAY = (_S.DISCONNECTED, _S.IDENTIFYING)  # a latch outlives the bus there, beside the state
TORQUE = (_S.ARMED, _S.SETTLING, *STOPPED)
CLIENT = (Motion.ACTIVE, Motion.STREAMING)


GRACE = 3  # ticks after the return of a bus in which something must act on its torque
RETURNED = 2  # ticks that a bus is back after which an ending daemon has switched it off
WAITED = 2  # ticks that a daemon waits at least for a lost bus with torque of its own


class ClaimBroken(AssertionError):
    """One claim does not hold; the text says which."""


class Claims:
    """Memory of what was ordered: a stop that was not followed by reset and arming, torque that was found."""

    def __init__(self, world: ModelWorld) -> None:
        self._world = world
        self.stopped = False  # a stop was ordered, or a fault occurred; until an arming after a reset
        self.acknowledged = False  # a reset was obeyed since
        self.found = world.truth.torque.copy()  # torque that was on before this daemon
        self.returned = 0  # ticks since a lost bus is back with torque that nothing acts on
        self.leased = False  # the Arm under way was ordered by the lease holder
        self.cut = False  # an e-stop of level `cut` was ordered; until a reset
        self.ordered = np.zeros_like(self.found)  # joints whose torque was ordered off, and is on
        self.awaited = np.zeros_like(self.found)  # the same by an e-stop, on a closed bus; until a reset
        self.undone = 0  # ticks in which nothing switched such torque off on an open bus
        self.tried = np.zeros_like(self.found)  # torque off was sent after SIGTERM, on buses open since
        self.waited = 0  # ticks since SIGTERM without a joint that is held
        # ticks that the bus of a joint was open before this one, up to RETURNED; all of them before SIGTERM
        self.open = RETURNED * world.hardware.open

    @property
    def memory(self) -> tuple[object, ...]:
        """Part of the key of a state."""
        masks = self.found, self.ordered, self.awaited, self.tried, self.open
        flags = self.stopped, self.acknowledged, self.leased, self.cut
        return *flags, self.returned, self.undone, self.waited, *(tuple(mask.tolist()) for mask in masks)

    def stop(self, level: str = "") -> None:
        """A stop is ordered; of a `level`, if it is an e-stop, which also waits for closed buses."""
        if level:
            self.awaited[:] = True
        self.cut = self.cut or level == "cut"
        self.stopped = True
        self.acknowledged = False

    def reset(self) -> None:
        """A reset was obeyed."""
        torque = self._world.loop.torque
        if torque.armed or torque.energising:
            raise ClaimBroken("a reset was obeyed with torque on")
        self.acknowledged = self.stopped
        self.cut = False
        self.awaited[:] = False

    def arm(self, *, leased: bool) -> None:
        """An arming is ordered."""
        self.leased = leased

    def lose(self) -> None:
        """A bus is about to be lost."""
        torque = self._world.loop.torque
        if torque.armed or torque.energising or torque.unconfirmed:
            self.stop()

    def release(self, rank: Priority) -> None:
        """Torque off is ordered, also what was found on; refused while a procedure as urgent runs."""
        running = self._world.loop.procedures.rank
        if running is None or running < rank:
            self.ordered |= self._world.hardware.open

    def request(self, name: str, joints: Any) -> None:
        """One request or goal leaves for these joints (n,)."""
        loop = self._world.loop
        rank = loop.procedures.rank
        if name == "torque False":
            self.tried |= joints & loop.condition.stop_wanted
            return
        if self.cut and name != "read goals":
            raise ClaimBroken(f"{name} after a cut, without a reset")
        if loop.torque.inhibited and name in ("goal", "torque True", "damp"):
            raise ClaimBroken(f"{name} while inhibited")
        if name == "torque True" and not (
            rank is Priority.ARM and self.leased and loop.condition.state is _S.ARMING
        ):
            raise ClaimBroken(f"torque on in state {loop.condition.state}, not by an arming of the holder")
        if name == "torque True" and self.stopped:
            raise ClaimBroken("torque on after a stop, without reset and arming")
        if name == "goal":
            self._goal(rank, joints)

    def _goal(self, rank: Priority | None, joints: Any) -> None:
        loop = self._world.loop
        if loop.condition.state not in TORQUE or not loop.torque.armed:
            raise ClaimBroken(f"a goal in state {loop.condition.state}, armed: {loop.torque.armed}")
        if (joints & ~loop.torque.held).any():
            raise ClaimBroken("a goal to a joint that is not held")
        if rank is Priority.CUT:
            raise ClaimBroken("a goal during a cut")
        if self.stopped and rank is None and loop.executor.motion in CLIENT:
            raise ClaimBroken("a goal of a client's motion after a stop")

    def after_tick(self) -> None:
        """After each tick."""
        loop = self._world.loop
        state = loop.condition.state
        torque = loop.torque
        on = self._world.truth.torque
        self.found &= on
        rank = loop.procedures.rank
        if state is _S.ARMING and self.stopped and self.acknowledged:
            self.stopped = False
        if ReasonCode.INTERNAL in loop.condition.latches:
            raise ClaimBroken(f"internal error: {loop.condition.latches[ReasonCode.INTERNAL].message}")
        # While other joints are held in a fault, an operator disarms all of them; else the daemon acts.
        waits = torque.pending_restore and not (torque.unconfirmed or torque.armed) and rank is None
        returned = waits and bool(self._world.hardware.open.all()) and bool((on & ~torque.held).any())
        self.returned = self.returned + 1 if returned else 0
        pending = torque.unconfirmed or (torque.pending_restore and self.returned <= GRACE)
        pending = pending or (torque.energising and rank is not None)
        if (on & ~torque.held & ~self.found).any() and not pending:
            raise ClaimBroken(f"torque of this daemon without an owner, in state {state}")
        if state is _S.ARMED and not torque.armed:
            raise ClaimBroken("state armed without torque")
        if torque.armed and state not in TORQUE:
            raise ClaimBroken(f"torque held in state {state}")
        if state is _S.ARMING and rank not in (Priority.ARM, Priority.DISARM):
            raise ClaimBroken(f"state arming, and {rank} owns the torque")
        if state is _S.SETTLING and rank is None:
            raise ClaimBroken("state settling, and nothing lowers the robot")
        over = loop.condition.finished and not on.any()  # nothing was left to stop
        if (
            self.stopped
            and not (self.acknowledged or over)
            and not (state in STOPPED or (state in AWAY and loop.condition.latched))
        ):
            raise ClaimBroken(f"state {state} after a stop, without a reset")
        self._release_goes_on(state, rank)
        if loop.condition.finished and torque.armed and not torque.inhibited:
            raise ClaimBroken("the daemon ended with torque that it holds")
        if loop.condition.finished and not torque.inhibited:
            self._ends(on)
        ending = loop.condition.stop_wanted
        ticks = np.minimum(self.open + 1, RETURNED) if ending else RETURNED
        self.open = ticks * self._world.hardware.open
        self.tried &= self._world.hardware.open
        self.waited = min(self.waited + 1, WAITED) if ending and not torque.armed else 0

    def _release_goes_on(self, state: RobotState, rank: Priority | None) -> None:
        """Torque that was ordered off goes off where its bus is open, also after an absence of the bus."""
        loop = self._world.loop
        self.awaited &= self._world.truth.torque
        self.ordered &= self._world.truth.torque
        if state is _S.ARMED:
            self.ordered[:] = False
        acts = (rank is not None and rank >= Priority.DISARM) or loop.torque.inhibited
        owed = (self.ordered | self.awaited) & self._world.hardware.open
        self.undone = self.undone + 1 if owed.any() and not acts else 0
        if self.undone > GRACE:
            raise ClaimBroken("torque was ordered off, is on, and nothing switches it off")

    def _ends(self, on: Any) -> None:
        """Torque of this daemon, or ordered off, was ordered off on open buses; closed ones were awaited."""
        owed = on & (~self.found | self.ordered | self.awaited)
        if (owed & (self.open == RETURNED) & self._world.hardware.open & ~self.tried).any():
            raise ClaimBroken("the daemon ended before it sent torque off, which was ordered")
        if (owed & (self.open == 0)).any() and self.waited < WAITED:
            raise ClaimBroken("the daemon ended without the wait for a lost bus")
