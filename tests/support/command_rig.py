"""Handlers of all commands on scripted buses: what each answers, begins and ends."""

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import pytest

from tests.support.gate_rig import path
from tests.support.procedure_rig import PERIOD, PLACE, ProcedureRig
from twind import link
from twind.loop.procedures import arming
from twind.loop.procedures.command_handlers import CommandHandlers
from twind.loop.procedures.procedure_runner import Priority, Procedure
from twind.loop.tick.loop_figures import LoopFigures
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode, Motion
from twind.safety.lease import Lease
from twind.safety.state_machine import RobotEvent

CLIENT, OTHER = 7, 9
FAULT = Finding(ReasonCode.FOLLOW_ERR, 1, message="rad: too far")
RANKS = tuple(Priority)


class LinkEnd:
    """End of the link of a front: messages that wait."""

    def __init__(self) -> None:
        self.lost = False
        self.waiting: list[Any] = []
        self.rereads = 0

    def commands(self, now: float) -> list[Any]:
        given, self.waiting = self.waiting, []
        return given

    def ask_reread(self) -> None:
        self.rereads += 1


class CommandRig(ProcedureRig):
    """A `ProcedureRig` whose commands are handled, with stand-ins for identification, modes and twin."""

    def __init__(self) -> None:
        super().__init__()
        self.lease = Lease()
        self.link = LinkEnd()
        self.entered: list[Mode] = []
        self.settled: list[float] = []
        self.placed: list[Any] = []
        self.twin: Any = SimpleNamespace(halted=False, place=self.placed.append)
        self.parts: Any = SimpleNamespace(
            lease=self.lease,
            guard=SimpleNamespace(bars=()),
            link=self.link,
            twin=self.twin,
            way=SimpleNamespace(),
            health=SimpleNamespace(),
            thresholds=SimpleNamespace(),
            live_denied=None,
            notifier=SimpleNamespace(send=lambda **_: None),
        )
        identity: Any = SimpleNamespace(verified=self.verified, settle_state=self.settled.append)
        modes: Any = SimpleNamespace(enter=self._enter)
        figures = LoopFigures(PERIOD, {})
        self.identified: list[str] = []
        for port in self.hardware.ports:
            port.identify = lambda name=port.name: self.identified.append(name)
        self.troubles: list[Finding] = []
        self.handlers = CommandHandlers(
            self, self.parts, identity, self.release, modes, figures, lambda: self.troubles
        )
        self.tickets = 0

    def _enter(self, mode: Mode) -> None:
        self.entered.append(mode)
        self.condition.mode = mode

    # ------------------------------------------------------------------------- calls

    def message(self, kind: Callable[..., Any], **how: Any) -> Any:
        """One message of the front."""
        if issubclass(kind, link.Command):  # type: ignore[arg-type]
            self.tickets += 1
            how = {"ticket": self.tickets, "client": CLIENT, "holder": "ann", "uid": 5} | how
        return SimpleNamespace(command=kind(**how), data=b"", fd=None)

    def serve(self, *messages: Any) -> None:
        """The commands of one tick."""
        self.link.waiting += messages
        self.handlers.serve(self.clock.now())

    def call(self, kind: Callable[..., Any], **how: Any) -> link.Reply:
        """One command, answered at once."""
        message = self.message(kind, **how)
        self.serve(message)
        return self.reply_to(message.command.ticket)

    def reply_to(self, ticket: int) -> link.Reply:
        [reply] = [each for each in self.book.replies if each.ticket == ticket]
        return reply

    def take_lease(self, client: int = CLIENT) -> None:
        assert self.lease.acquire(client, "ann", 5, self.clock.now(), take=True)

    # ------------------------------------------------------------------------- surroundings

    def occupy(self, rank: Priority) -> None:
        """A procedure that owns the torque, and does not end by itself."""

        def waits() -> Procedure:
            while True:
                yield

        assert self.own(rank, waits)

    def move(self) -> None:
        """An armed robot follows a trajectory."""
        self.hold(PLACE)
        assert self.executor.submit("wave", path([2.0], PLACE + 0.3)) is None
        self.tick()

    def texts(self, code: str | None = None) -> Sequence[str]:
        """Messages of the events so far."""
        return [event.message for event in self.book.events if code is None or event.code == code]


def latch(rig: CommandRig, *faults: Finding) -> None:
    for fault in faults:
        rig.condition.latch(fault)
    rig.condition.change(RobotEvent.FAULT)


def ended(rig: CommandRig) -> Finding:
    """Why the trajectory that ran was aborted."""
    [outcome] = [each for each in rig.executor.outcomes() if each.id == "wave"]
    assert outcome.phase == "aborted"
    [finding] = outcome.findings
    return finding


def begin_arming(
    rig: CommandRig, monkeypatch: pytest.MonkeyPatch, outcome: Any = None, **how: Any
) -> list[Any]:
    """An arming that waits, or ends at its second step; returns its arguments."""
    seen: list[Any] = []

    def arm(*given: Any) -> Any:
        seen.extend(given)
        yield
        while outcome is None:
            yield
        return outcome

    monkeypatch.setattr(arming, "arm", arm)
    rig.serve(rig.message(link.Arm, **how))
    return seen


def streams(rig: CommandRig, motion: Motion) -> list[Any]:
    """The executor seems to be in this motion; its stops are noted."""
    stops: list[Any] = []
    rig.executor = SimpleNamespace(motion=motion, waiting=False, stop=lambda *how: stops.append(how))
    return stops
