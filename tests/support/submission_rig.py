"""Trajectories and setpoints beside a real gate and executor: three joints that hold in mode live."""

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from tests.support.gate_rig import path, snapshot
from tests.support.procedure_rig import PLACE, ProcedureRig
from twind import link
from twind.loop.procedures.trajectory_submissions import TrajectorySubmissions
from twind.robot.finding import Finding
from twind.robot.trajectory import Trajectory
from twind.safety.gate_types import GateSnapshot, GateThresholds
from twind.safety.lease import Lease

CLIENT, OTHER = 7, 9
FOLLOW, DRIFT_FOR = 0.3, 2.0  # rad, s: bounds of a simulated goal
RECEIVED = 99.5  # s


class Way:
    """Tracer of latencies: its notes, in order."""

    def __init__(self) -> None:
        self.notes: list[tuple[Any, ...]] = []

    def take(self, *given: Any) -> str:
        self.notes.append(("take", *given))
        return "taken"

    def judge(self, *given: Any) -> None:
        self.notes.append(("judge", *given))

    def accept(self, *given: Any) -> None:
        self.notes.append(("accept", *given))

    def end(self, *given: Any) -> None:
        self.notes.append(("end", *given))


class SubmissionRig(ProcedureRig):
    """Armed; `CLIENT` has the lease. The gate sees the robot as it is, but for what `seen` replaces."""

    def __init__(self) -> None:
        super().__init__()
        self.lease = Lease()
        assert self.lease.acquire(CLIENT, "ann", 5, self.clock.now())
        self.way = Way()
        self.contact: Any = None
        self.seen: dict[str, Any] = {}
        self.gate_input: Any = SimpleNamespace(
            busy=False, judged_since=0, thresholds=GateThresholds(), snapshot=self._snapshot
        )
        parts: Any = SimpleNamespace(
            way=self.way,
            lease=self.lease,
            guard=SimpleNamespace(bounds=SimpleNamespace(follow=FOLLOW, drift_for=DRIFT_FOR)),
            twin=SimpleNamespace(contact=lambda joint: self.contact),
        )
        self.figures: Any = SimpleNamespace(ticks=42)
        self.submissions = TrajectorySubmissions(self, parts, self.gate_input, self.figures)
        self.tickets = 0
        self.hold(PLACE)
        self.reports.urgent = False

    def _snapshot(self, client: int, now: float) -> GateSnapshot:
        here = self.executor.reference
        usual = snapshot(3, self.condition.mode, now=now, lease_held=self.lease.held_by(client, now))
        usual = replace(usual, state=self.condition.state, motion=self.executor.motion, limp=self.torque.limp)
        usual = usual if here is None else replace(usual, reference=here)
        return replace(usual, latched=tuple(self.condition.latches), **self.seen)

    def tick(self) -> None:
        super().tick()
        self.executor.observe(self.robot.measured)
        self.submissions.report(self.clock.now())

    # ------------------------------------------------------------------------- calls

    def submit(self, way: Trajectory | None = None, data: bytes | None = None, **how: Any) -> int:
        """Begin a trajectory: where none is given, 0.1 rad of all joints in a second."""
        way = to(self, 0.1) if way is None else way
        self.tickets += 1
        given = {
            "ticket": self.tickets,
            "client": CLIENT,
            "received": RECEIVED,
            "id": f"t{self.tickets}",
            "points": len(way.time),
            "commanded": np.flatnonzero(way.commanded).tolist(),
        }
        command = link.Submit(**(given | how))  # type: ignore[arg-type]
        self.submissions.begin(command, link.pack_path(way) if data is None else data, self.clock.now())
        return self.tickets

    def setpoint(self, *positions: float, joints: Sequence[int] = (1,), **how: Any) -> link.Reply:
        """The reply to a setpoint, which comes at once."""
        self.tickets += 1
        given = {"ticket": self.tickets, "client": CLIENT, "received": RECEIVED}
        command = link.Setpoint(joints=joints, positions=positions, **(given | how))  # type: ignore[arg-type]
        self.submissions.setpoint(command, self.clock.now())
        [reply] = self.replies(self.tickets)
        return reply

    def replies(self, ticket: int) -> list[link.Reply]:
        return [each for each in self.book.replies if each.ticket == ticket]

    def only(self, ticket: int) -> link.Reply:
        [reply] = self.replies(ticket)
        return reply

    def verdicts(self) -> list[link.VerdictReport]:
        return [each for each in self.book.events if isinstance(each, link.VerdictReport)]

    def logged(self) -> list[link.Event]:
        return [each for each in self.book.events if isinstance(each, link.Event)]

    def traced(self, what: str) -> list[tuple[Any, ...]]:
        """Notes of the tracer of this kind."""
        return [given for kind, *given in self.way.notes if kind == what]  # type: ignore[misc]


def to(rig: SubmissionRig, by: float, seconds: float = 1.0) -> Trajectory:
    """A path of all joints by so many rad from where they are commanded."""
    return path([seconds], [rig.executor.reference.position + by])


def hold_path(rig: SubmissionRig, points: int) -> Trajectory:
    """A path of so many points, all where the robot holds."""
    time = [0.02 * (k + 1) for k in range(points)]
    return path(time, [rig.executor.reference.position] * points)


def codes(reply: link.Reply) -> list[str]:
    """Codes of a refusal."""
    assert reply.error == "Refused", reply
    return [str(_code(each)) for each in reply.parameters["findings"]]


def _code(finding: Finding | dict[str, Any]) -> Any:
    return finding.code if isinstance(finding, Finding) else finding["code"]
