"""A daemon with several clients, its front and its own life in the test's hands, under a fake clock.

Everything is real but time, the processes and the front: the loop, the link, the driver, the servos' bytes.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.proof.busmon.watched import Watched
from tests.proof.model.history import ENDS, History, Op
from tests.proof.model.invariants import Invariants
from tests.support.daemon_rig import HandFront, Rig
from twind import link
from twind.config.calibration_file import dump_calibration
from twind.robot.modes import Mode

AGAIN = 0.2  # s between a front's death and the next one
JOINT = "head_yaw"


class MortalFront(HandFront):
    """A front that can be killed, and that the loop starts anew."""

    def __init__(self, now: Callable[[], float]) -> None:
        super().__init__()
        self._now = now
        self._start_at = 0.0

    def kill(self) -> None:
        """SIGKILL: its end of the link is closed, and what it had not read is gone."""
        self.outer.close()

    def end(self, now: float) -> None:
        super().end(now)
        self._start_at = now + AGAIN

    def due(self, now: float) -> bool:
        return self.socket is None and now >= self._start_at

    def start(self, now: float) -> None:
        del now
        HandFront.__init__(self)


@dataclass
class Fault:
    """One that was ordered, and by when which event must have told of it (H4)."""

    name: str
    codes: frozenset[str]
    begin: float
    bound: float


class World(Rig):
    """`begin` starts a call of a client, `pass_` lets time pass; what came of it is in `history`."""

    def __init__(self, folder: Path, mode: Mode = Mode.LIVE) -> None:
        super().__init__(mode=mode)
        self.history = History()
        self.clients: list[int] = []
        self._number = 0
        self._calls = dict[int, Op]()
        self._motions: dict[str, Op] = {}
        self.faults: list[Fault] = []
        self.lives = 1
        file = folder / "calibration.yaml"
        file.write_text(dump_calibration(self.calibration))
        self.watched = Watched(self, file)
        self.invariants = Invariants(self)

    def new_front(self) -> HandFront:
        return MortalFront(lambda: self.clock.now())

    # ----------------------------------------------------------------------- clients

    def connect_client(self) -> int:
        """A number that was never used before."""
        self._number += 1
        self.clients.append(self._number)
        return self._number

    def disconnect(self, client: int) -> None:
        self._say(link.ConnectionClosed(client=client))
        self.clients.remove(client)
        self.history.gone[client] = self.clock.now()
        self._lose(lambda op: op.client == client)

    def begin(self, client: int, kind: type[link.Command], **parameters: Any) -> Op:
        """A call; its answer is noted when it comes."""
        more = bool(parameters.get("more"))
        op = Op(client, kind.__name__, self.clock.now(), take=bool(parameters.get("take")), more=more)
        self.history.ops.append(op)
        if self.front.socket is None:
            op.result = "lost"
            op.end = op.begin
        else:
            self._calls[self.send(kind, client=client, **parameters)] = op
        return op

    def begin_motion(self, client: int, place: float, seconds: float, *, more: bool) -> Op:
        """SubmitTrajectory of one joint."""
        op = Op(client, "SubmitTrajectory", self.clock.now(), more=more)
        self.history.ops.append(op)
        if self.front.socket is None:
            op.result = "lost"
            op.end = op.begin
            return op
        path = self.path(JOINT, [place], [seconds])
        if not np.isfinite(path.position).all():
            path = self.path(JOINT, [place], [seconds])
            path.position[:] = np.nan_to_num(path.position)
        ticket = self.submit(path, client=client, more=more, append_stop=True)
        self._calls[ticket] = op
        self._motions[f"t{ticket}"] = op
        return op

    def _say(self, message: Any) -> None:
        if self.front.socket is not None:
            self.front.outer.send(link.encode(message))

    def _lose(self, which: Callable[[Op], bool]) -> None:
        """Calls whose answers can come no more, and motions of which nobody is told."""
        now = self.clock.now()
        for ticket, op in list(self._calls.items()):
            if which(op):
                del self._calls[ticket]
                op.result = op.result or "lost"
                op.end = min(op.end, now)
        for op in self._motions.values():
            if which(op):
                op.kept = min(op.kept, now)

    # ----------------------------------------------------------------------- time

    def pass_(self, seconds: float) -> None:
        """Let time pass; every rule holds in every tick."""
        for _ in range(max(1, round(seconds / self.loop.robot.period))):
            before = len(self.news)
            self.ticks(1)
            self._hear(self.news[before:])
            self.watched.look()
            self.invariants.tick(self.news[before:])
            del self.news[: max(0, len(self.news) - 2000)]

    def _hear(self, news: list[Any]) -> None:
        now = self.clock.now()
        for each in news:
            if isinstance(each, link.Reply) and each.ticket in self._calls:
                self._answer(self._calls[each.ticket], each, now)
                if not each.continues:
                    del self._calls[each.ticket]
            elif isinstance(each, link.Event) and each.code == "MOTION":
                op = self._motions.get(each.id)
                if op is not None and each.phase in ENDS and not op.fate:
                    op.fate = each.phase
                    op.codes = tuple(finding.code.value for finding in each.findings)

    @staticmethod
    def _answer(op: Op, reply: link.Reply, now: float) -> None:
        if not op.result:
            findings = reply.parameters.get("findings") or [{}]
            code = str(findings[0].get("code")) if isinstance(findings[0], dict) else str(findings[0].code)
            op.end = now
            op.result = "ok" if reply.error is None else reply.error
            if reply.error == "Refused":
                codes = [finding.get("code") for finding in findings]
                op.result = "LEASE_MISSING" if "LEASE_MISSING" in codes else code
            op.motion = str(reply.parameters.get("id", "")) if reply.error is None else ""
        if op.more and op.result == "ok" and not reply.continues:
            op.kept = now

    # ----------------------------------------------------------------------- lives

    def kill_front(self) -> None:
        """Every connection dies with it."""
        assert isinstance(self.front, MortalFront)
        if self.front.socket is None:
            return
        self.front.kill()
        self.history.deaths.append(self.clock.now())
        self._lose(lambda op: True)
        self.clients.clear()
        self.pass_(AGAIN + 0.05)

    def kill_daemon(self, mode: Mode, pause: float) -> None:
        """SIGKILL; the servos live on, and after `pause` s another daemon begins."""
        now = self.clock.now()
        self.watched.take_report("killed", now)
        self.front.end(now)
        self.history.deaths.append(now)
        self._lose(lambda op: True)
        for op in self._motions.values():  # nobody is left to tell: the connection's end says so
            op.fate = op.fate or "lost"
        self.clients.clear()
        self.faults.clear()
        self.clock.sleep_until(now + pause)
        self.watched.take_report("servos", self.clock.now(), **self._servos())
        rest = self.counts
        self.front = self.new_front()
        self.news.clear()
        self.loop = self.born(mode)
        self.watched.take_report("born", self.clock.now())
        self.next_tick = self.clock.now()
        self.lives = self.lives + 1
        self.invariants.born(rest)

    def _servos(self) -> dict[str, Any]:
        self.advance_servos()
        velocity: dict[int, float] = {}
        delay: dict[int, float] = {}
        for bus in self.virtual.values():
            for row, id in enumerate(bus.servos["id"]):
                on = bool(bus.servos["torque_enable"][row])
                velocity[int(id)] = float(bus.servos.muscles.velocity[row])
                if on and bus.is_plugged:
                    delay[int(id)] = float(bus.servos.trip_delay[row])
        return {"velocity": velocity, "trip_delay": delay}

    # ----------------------------------------------------------------------- faults

    def order(self, fault: str, codes: set[str], bound: float, **given: Any) -> None:
        """A fault of the servos or of the wire, and what must be told of it within `bound` s."""
        for bus in self.virtual.values():
            bus.advance(self.clock.now())
            getattr(bus.faults, fault)(**given)
        if codes:
            self.faults.append(Fault(fault, frozenset(codes), self.clock.now(), bound))

    def heal(self) -> None:
        """All faults end."""
        for bus in self.virtual.values():
            bus.advance(self.clock.now())
            bus.faults.clear()
            if not bus.is_plugged:
                bus.faults.replug()
