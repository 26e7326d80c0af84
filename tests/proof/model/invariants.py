"""X1-X5, H1-H4 and the wire, after every tick. Judges by the news, the servos and the bytes."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any

import numpy as np

from twind import link
from twind.loop.procedures.torque_readback import torque_known

if TYPE_CHECKING:
    from tests.proof.model.world import World

FRESH = 0.1  # s: torque as reported was true within that (X3)
COUNTS = 2.0  # that a restart may move a joint (X5)
WATCH = 0.6  # s after a birth in which nobody commands and nothing may move
PATIENCE = 32.0  # s that any call may take
LATCHES = ("fault", "estop", "inhibited")


class Invariants:
    """Raises AssertionError at the first tick in which something is not so."""

    def __init__(self, world: World) -> None:
        self.world = world
        self.ticks = self.armed_ticks = self.reported = 0
        self._torque: deque[tuple[float, Any]] = deque(maxlen=40)
        self._events: deque[link.Event] = deque(maxlen=400)
        self.born(None)

    def born(self, rest: Any) -> None:
        """Another daemon: its counts begin anew; it moves nothing."""
        self._sequence = -1
        self._heard = 0
        self._epoch = 0
        self.sound = True  # nothing was wrong so far
        self._time = -np.inf
        self._state = "disconnected"
        self._mode = str(self.world.loop.condition.mode.value)
        self._rest = rest
        self._born = self.world.clock.now()
        self._latched = False

    def tick(self, news: list[Any]) -> None:
        """After a tick, with what it told."""
        now = self.world.clock.now()
        self.sound = False
        torque = self.world.register("torque_enable").astype(bool).copy()
        self._torque.append((now, torque))
        for each in news:
            if isinstance(each, link.Tick):
                self._tick(each)
            elif isinstance(each, link.Event):
                self._event(each)
            elif isinstance(each, link.Overview):
                assert each.time >= self._born
        self._lease()
        self._reported(now)
        self._still(now)
        self._check_reports(now)
        self.world.watched.verdict()
        self.sound = True

    # ----------------------------------------------------------------------- X1, X2

    def _tick(self, tick: link.Tick) -> None:
        """Counts grow, gaps are marked (H3), and what is armed was armed by somebody (X1)."""
        gap = tick.sequence - self._sequence - 1
        assert gap >= 0, f"tick {tick.sequence} after {self._sequence}"
        assert self._sequence < 0 or gap <= tick.dropped, f"{gap} ticks missing, {tick.dropped} said"
        assert tick.time > self._time
        self._sequence = tick.sequence
        self._time = tick.time
        if tick.mode != self._mode:
            asked = [op for op in self.world.history.ops[-60:] if op.name == "SetMode"]
            assert asked, f"mode {self._mode} became {tick.mode} and nobody asked"
            self._mode = tick.mode
        self.ticks = self.ticks + 1
        self.armed_ticks = self.armed_ticks + tick.armed
        if tick.armed:
            assert tick.mode == "live", tick.mode
            assert tick.state in ("armed", "settling", "fault", "estop"), tick.state
        if tick.motion in ("active", "streaming") and tick.mode == "live":
            assert tick.state != "connected", f"{tick.motion} while {tick.state}"

    def _event(self, event: link.Event) -> None:
        assert event.sequence > self._heard, f"event {event.sequence} after {self._heard}"
        self._heard = event.sequence
        self._events.append(event)
        if not event.before:
            return
        before = event.before
        after = event.code
        why = event.cause
        assert before == self._state, f"{before} to {after}, but it was {self._state}"
        self._state = after
        if after in LATCHES:
            self._latched = True
        if self._latched and why == "reset":
            asked = [op for op in self.world.history.ops if op.name == "Reset" and op.begin >= self._born]
            assert asked, "a latch was reset and nobody asked"
            self._latched = False
        if after in ("arming", "armed"):
            assert not self._latched, f"{before} to {after} with a latch set"
            assert before == ("connected" if after == "arming" else "arming"), f"{before} to {after}"
        if after == "arming":
            asked = [op for op in self.world.history.ops if op.name == "Arm" and not op.result]
            assert asked, "arming, and nobody asked"

    def _lease(self) -> None:
        epoch = self.world.loop.parts.lease.epoch
        assert epoch >= self._epoch, f"lease epoch {epoch} after {self._epoch}"
        self._epoch = epoch

    # ----------------------------------------------------------------------- X3, X4, X5

    def _reported(self, now: float) -> None:
        """Torque of joints that answer is what it was, somewhere in the last 100 ms."""
        loop = self.world.loop
        known = torque_known(loop)
        age = loop.robot.measured.age
        recent = [torque for time, torque in self._torque if time >= now - FRESH - loop.robot.period]
        ever_on = np.any(recent, axis=0)
        ever_off = ~np.all(recent, axis=0)
        if loop.condition.mode.value == "sim" or len(recent) < 10:
            return
        heard = age <= FRESH
        lies = heard & (((known == 1) & ~ever_on) | ((known == 0) & ~ever_off))
        assert not lies.any(), f"torque reported wrongly of joints {np.flatnonzero(lies)}"

    def _still(self, now: float) -> None:
        if self._rest is None or now - self._born > WATCH:
            return
        commanded = [
            op for op in self.world.history.ops[-20:] if op.begin >= self._born and op.name != "GetStatus"
        ]
        if not commanded:
            moved = np.abs(self.world.counts - self._rest)
            assert moved.max() <= COUNTS, (
                f"a restart moved joint {int(moved.argmax())} by {moved.max()} counts"
            )

    def armed(self, before: Any, result: str) -> None:
        """An Arm was answered and a moment has passed: all, or none but those that were on (X4)."""
        torque = self._torque[-1][1]
        if result == "ok":
            return
        extra = torque & ~before
        assert not extra.any(), f"Arm failed ({result}) and joints {np.flatnonzero(extra)} are on"

    # ----------------------------------------------------------------------- H1, H4

    def _check_reports(self, now: float) -> None:
        """Check that every fault was reported in time."""
        for fault in list(self.world.faults):
            if any(event.time >= fault.begin and event.code in fault.codes for event in self._events):
                self.world.faults.remove(fault)
                self.reported += 1
            else:
                late = now - fault.begin
                assert late <= fault.bound, f"{fault.name}: none of {sorted(fault.codes)} within {late:.3f} s"

    def is_reported(self, code: str, seconds: float) -> bool:
        """Check for a report within the last `seconds`: a repeated fault has none of its own."""
        since = self.world.clock.now() - seconds - 1.0
        return any(event.code == code and event.time >= since for event in self._events)

    def end(self) -> None:
        """The whole history: one order of events explains it, and nobody waits for ever."""
        wrong = self.world.history.wrong()
        wrong += self.world.history.unanswered(self.world.clock.now(), PATIENCE)
        assert not wrong, "\n".join(wrong[:10])
