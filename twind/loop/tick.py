"""The loop: one tick on one screen, and what it keeps. Runs in the daemon's main process, in one thread.

No asyncio, no files, no logging: news leave by the link. Time is an argument below `run`.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby
from math import floor, nan
from typing import TYPE_CHECKING, Any

import numpy as np

from twind import link as messages
from twind.loop import requests, torque
from twind.loop.figures import Figures
from twind.loop.identity import Identity, Judge
from twind.loop.procedures import Procedures, Rank
from twind.loop.publish import Publisher
from twind.robot.arrays import Floats
from twind.robot.finding import Code, Finding, Verdict
from twind.robot.modes import Mode, Motion, State
from twind.robot.state import JointState
from twind.robot.trajectory import Reference
from twind.safety import gate
from twind.safety.guard import Facts, Guard, Judgement, Reaction
from twind.safety.states import LATCHED, Event, Latch
from twind_drivers.bus import WireClamp

if TYPE_CHECKING:
    from collections.abc import Sequence

    from twind.loop.hardware import Hardware
    from twind.loop.link import Link
    from twind.loop.notify import Notifier
    from twind.motion.executor import Executor
    from twind.robot.joints import JointMap
    from twind.robot.limits import Limits
    from twind.safety.health import Health
    from twind.safety.lease import Lease
    from twind.twin.twin import Twin
    from twind_drivers.clock import Clock

PATIENCE = 3  # ticks in a row that may fail with an exception before the daemon gives up (R26)


@dataclass(frozen=True, slots=True)
class Parts:
    """What a loop is made of; put together in `assembly`."""

    clock: Clock
    period: float  # s
    joints: JointMap
    limits: Limits
    rest: Floats  # rad, (n,)
    support: str
    hardware: Hardware
    twin: Twin
    executor: Executor
    guard: Guard
    lease: Lease
    health: Health
    thresholds: gate.Thresholds
    link: Link
    notifier: Notifier
    realtime: dict[str, str]
    judge: Judge  # devices -> findings of S09
    live_denied: Finding | None  # why this daemon cannot go live; None: it can


class Loop:
    """State of the daemon: everything a tick reads and writes."""

    def __init__(self, parts: Parts, mode: Mode) -> None:
        self.parts = parts
        self.clock, self.period, self.joints, self.limits = (
            parts.clock,
            parts.period,
            parts.joints,
            parts.limits,
        )
        self.rest, self.support = parts.rest, parts.support
        self.hardware, self.twin, self.executor = parts.hardware, parts.twin, parts.executor
        self.lease, self.health, self.link = parts.lease, parts.health, parts.link
        self.procedures = Procedures()
        self.submissions = requests.Submissions(self)
        self.figures = Figures(parts.period, parts.realtime)
        self.publisher = Publisher(self)
        self.mode = mode
        self.condition = Latch()
        self.latches: dict[Code, Finding] = {}
        self.identity = Identity(self, parts.judge)
        self.armed = self.inherited = self.inhibited = self.finished = False
        self.energising = False  # torque-on was ordered, and neither read back nor taken back
        self.stop_wanted = False  # SIGTERM: lower the robot, then end
        self.untouched = True  # nobody has moved the simulation since the mode was entered
        self.written: Floats | None = None  # the last goal that really left, rad (n,)
        self.lateness, self.missed_in_a_row, self._failures = 0.0, 0, 0
        still = np.zeros(len(parts.joints))
        never = np.full(len(parts.joints), np.inf)
        self.measured = JointState(
            self.clock.now(), still * nan, still * nan, still * nan, never, still > 0.0, nan
        )
        self.simulated = self.twin.update(None, None, self.clock.now())
        self.enter(mode)

    # ------------------------------------------------------------------------------- time

    def run(self, until: float = np.inf) -> None:
        """Tick at absolute deadlines until finished. A missed tick is counted, never caught up."""
        deadline = self.clock.now()
        while not self.finished and deadline < until:
            self.clock.sleep_until(deadline)
            now = self.clock.now()
            self.lateness = now - deadline
            self.attempt(now)
            deadline += self.period
            behind = floor((self.clock.now() - deadline) / self.period) + 1
            self.missed_in_a_row = max(0, behind)
            deadline += self.missed_in_a_row * self.period
            self.figures.tick(self.lateness, self.missed_in_a_row)

    def tick(self, now: float) -> None:
        """One period: commands, procedures, gate, exchange, twin, news."""
        for incoming in self.link.commands(now):
            requests.begin(self, incoming, now)
        if self.link.lost:
            requests.front_lost(self)
        if self.stop_wanted:
            self.procedures.own(Rank.SHUTDOWN, lambda: torque.shutdown(self, now))
        self.procedures.step(now)
        live = self.mode is Mode.LIVE
        target = self.measured if live else self.simulated  # whom commands go to, and who judges them
        goal = self.guard(self.executor.goal(now), target, now)
        self.written = goal if goal is not None else self.written
        self.measured = self.hardware.exchange(goal if live else None, now)
        read = self.clock.now()
        self.simulated = self.twin.update(self.measured, goal, now)
        self.identity.watch(now)
        self.observe(now, read)
        self.publisher.publish(now)

    def attempt(self, now: float) -> None:
        """A tick, and the loop's single catch-all: hold the last goal; give up when that fails too (R26)."""
        try:
            self.tick(now)
        except WireClamp as error:
            self.fail(Finding(Code.WIRE_CLAMP, value=float(error.value), message=str(error)), now)
        except Exception as error:
            self._failures += 1
            if self._failures >= PATIENCE:
                self.inhibit(Finding(Code.INTERNAL, message=repr(error)), now)
                raise
            self.fail(Finding(Code.INTERNAL, message=repr(error)), now)
        else:
            self._failures = 0
            self.parts.notifier.alive(now)

    # ------------------------------------------------------------------------------- the per-tick gate

    def guard(self, reference: Reference | None, target: JointState, now: float) -> Floats | None:
        """What may be written this tick: the goal, the last goal again, or nothing."""
        held = self.lease.holds(now) or self.procedures.rank is not None
        slow = self.hardware.slow
        judgement = self.parts.guard.judge(
            Facts(
                now=now,
                mode=self.mode,
                state=self.state,
                motion=self.executor.motion,
                period=self.period,
                lateness=self.lateness,
                missed_in_a_row=self.missed_in_a_row,
                measured=target if np.isfinite(target.age).any() else None,  # nobody was ever heard
                goal=reference,
                previous=self.written if reference is not None else None,
                lease_ok=held,
                setpoint_age=self.executor.setpoint_age(now),
                torque=slow.torque,
                torque_expected=self.armed,
                torque_settled=self.procedures.rank is None,
                watchdog=slow.watchdog,
                status_time=slow.status_time,
                discarded=self.hardware.discarded,
            )
        )
        return self.react(judgement, reference, now)

    def react(self, judgement: Judgement, reference: Reference | None, now: float) -> Floats | None:
        """Do what the guard says. A goal that may not leave becomes the last goal again."""
        for code, findings in groupby(judgement.findings, key=lambda finding: finding.code):
            same = tuple(findings)
            self.event("warning", code, same[0].message, same)
        if judgement.latches:
            for finding in judgement.findings:
                self.latch(finding)
            if self.state is not State.ESTOP:
                self.change(Event.FAULT, now)
        if judgement.reaction >= Reaction.INHIBIT:
            self.inhibit(judgement.findings[0], now)
        elif judgement.reaction >= Reaction.SETTLE and self.armed:
            self.procedures.own(Rank.FAULT, lambda: torque.fault(self, now))
        elif judgement.reaction >= Reaction.HOLD and self.executor.motion is not Motion.HOLDING:
            self.executor.stop("aborted", judgement.findings)
        if self.inhibited or reference is None:
            return None
        if judgement.goal_refused:
            if self.written is not None:
                self.executor.begin(self.written)
            return self.written
        return reference.position

    # ------------------------------------------------------------------------------- state

    def enter(self, mode: Mode) -> None:
        """Take up a mode: what is open, and where the target of commands stands."""
        self.mode = mode
        self.written = None
        self.hardware.access(read=mode is not Mode.SIM, write=mode is Mode.LIVE)
        if mode is Mode.SIM and self.state not in (State.DISCONNECTED, *LATCHED):
            self.change(Event.PORT_LOST, self.clock.now())
        self.executor.idle()
        if mode is not Mode.LIVE:
            whole = mode is Mode.MIRROR and bool(np.isfinite(self.measured.position).all())
            place = self.measured.position if whole else self.simulated.position
            self.twin.place(place)
            self.executor.begin(place)

    def change(self, event: Event, now: float) -> None:
        """The robot's state takes an event; news of it leave this tick."""
        before = self.state
        self.condition = self.condition.after(event)
        if self.state is not before:
            self.publisher.urgent = True
            self.event("info", self.state.value, f"{before.value} → {self.state.value} ({event.value})")

    def latch(self, finding: Finding) -> None:
        """Keep a fault until an operator acknowledges it."""
        if finding.code not in self.latches:
            self.latches[finding.code] = finding
            self.publisher.urgent = True

    def fail(self, finding: Finding, now: float) -> None:
        """A fault of our own: hold the last goal, latch, say so."""
        self.event("error", finding.code, finding.message, (finding,))
        self.latch(finding)
        if self.written is not None and self.executor.motion is not Motion.IDLE:
            self.executor.begin(self.written)
        if self.state is not State.ESTOP:
            self.change(Event.FAULT, now)

    def inhibit(self, finding: Finding, now: float) -> None:
        """Nothing more is written; the servos' own watchdogs end the motion, torque stays."""
        self.inhibited = True
        self.latch(finding)
        self.executor.idle()
        self.hardware.clear()
        self.change(Event.INHIBIT, now)

    @property
    def state(self) -> State:
        """Of the robot and its bus."""
        return self.condition.state

    @property
    def energised(self) -> bool:
        """Some joint has torque, as far as we know."""
        ours = self.armed or self.inherited or self.energising
        return ours or bool((self.hardware.slow.torque == 1).any())

    @property
    def torque_off(self) -> bool | None:
        """Read back off everywhere; None where there is no bus to ask."""
        if self.mode is Mode.SIM or not self.hardware.connected:
            return None
        return bool((self.hardware.slow.torque == 0).all())

    def close(self) -> None:
        """Let go of the ports, and of the front."""
        self.link.flush()
        self.hardware.close()
        self.link.front.end(self.clock.now())

    # ------------------------------------------------------------------------------- judging

    def snapshot(self, client: int, now: float) -> gate.Snapshot:
        """What the gate must know, now."""
        live = self.mode is Mode.LIVE
        target = self.measured if live else self.simulated
        still = np.zeros(len(self.joints))
        reference = self.executor.reference or Reference(target.position, still, still)
        return gate.Snapshot(
            now=now,
            mode=self.mode,
            state=self.state,
            motion=self.executor.motion,
            latched=tuple(self.latches),
            lease_held=self.lease.held_by(client, now),
            mismatches=self.identity.mismatches,
            calibrated=np.array(self.joints.calibrated),
            age=now - target.time + target.age,
            latency=self.health.latency(now),
            latency_p95=self.health.latency_p95(now),
            reference=reference,
            busy=self.submissions.busy,
        )

    def may_arm(self, client: int, now: float) -> Verdict:
        """S05–S11 for the verb Arm."""
        return gate.arming(self.snapshot(client, now), self.parts.thresholds)

    def observe(self, now: float, read: float) -> None:
        """Health, tolerances and outcomes; `read` is when the exchange was over (s)."""
        if self.measured.heard.any():
            self.health.hop("state", read - self.measured.time, now)
            self.health.hop("twin", self.clock.now() - read, now)
        found = self.health.update(self.measured, self.hardware, now, live=self.mode is not Mode.SIM)
        for finding in found:
            self.event("warning", finding.code, "latency is above the warning threshold", (finding,))
        self.executor.observe(self.measured if self.mode is Mode.LIVE else self.simulated)
        self.submissions.report(now)

    # ------------------------------------------------------------------------------- answers and news

    def reply(self, command: messages.Command, *, continues: bool = False, **parameters: Any) -> None:
        """An answer to a call."""
        self.link.reply(messages.Reply(ticket=command.ticket, parameters=parameters, continues=continues))

    def error(self, command: messages.Command, error: str, /, **parameters: Any) -> None:
        """A call that failed: the interface's `error`."""
        self.link.reply(messages.Reply(ticket=command.ticket, parameters=parameters, error=error))

    def refuse(self, command: messages.Command, findings: Sequence[Finding]) -> None:
        """A call that the gate refused."""
        self.error(command, "Refused", findings=list(findings))

    def event(self, level: str, code: str, message: str, findings: Sequence[Finding] = ()) -> None:
        """Something a person may want to know."""
        self.link.event(
            messages.Event(
                time=self.clock.now(),
                sequence=self.link.sequence(),
                level=level,
                code=str(code),
                message=message,
                findings=list(findings),
            )
        )
