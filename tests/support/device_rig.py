"""Calls on single devices, on buses whose scripts end as the test says."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from tests.support.procedure_rig import ProcedureRig
from twind import link
from twind.loop.bus.script_run import ScriptRun
from twind.loop.ipc.call_outcome import CallFailure
from twind.loop.procedures.device_procedures import DeviceCommands
from twind_drivers.bus import PingRequest

ROUNDS = 3  # ticks of each script


class Port:
    """A bus whose scripts take `ROUNDS` ticks; `ends` has the result or error of each, by its text."""

    def __init__(self, name: str, ids: tuple[int, ...]) -> None:
        self.name = name
        self.trouble = ""
        self.full = False
        self.holding = False
        self.asked: list[str] = []
        self.ends: dict[str, Any] = {}
        self.keeping = False  # registers survive power-off
        self.known = True  # so do they, or nobody knows
        self.tasks: list[ScriptRun[Any]] = []
        self.reader: Any = SimpleNamespace(
            ids=ids, read=self._reads, identify=self._identifies, keeps=self._keeps
        )
        self.writer: Any = SimpleNamespace(
            cut=lambda: None,
            write=lambda id, name, value: self._script(f"write {id} {name} {value}"),
            reboot=lambda id: self._script(f"reboot {id}"),
        )

    def _reads(self, id: int, name: str) -> Any:
        return self._script(f"read {id} {name}")

    def _identifies(self) -> Any:
        return self._script("scan")

    def _keeps(self, id: int, name: str) -> bool:
        if not self.known:
            raise KeyError(name)
        return self.keeping

    def _script(self, text: str) -> Any:
        self.asked.append(text)
        for _ in range(ROUNDS):
            yield PingRequest(1)
        end = self.ends.get(text)
        if isinstance(end, Exception):
            raise end
        return end

    def run(self, script: Any) -> ScriptRun[Any]:
        task = ScriptRun(script)
        task.advance(None)
        self.tasks.append(task)
        return task

    def identify(self) -> None:
        self.asked.append("identify")

    def serve(self) -> None:
        for task in [task for task in self.tasks if not task.done]:
            task.advance(SimpleNamespace())  # type: ignore[arg-type]


class DeviceRig(ProcedureRig):
    """Two buses, whose torque reads off. No search runs, and the robot is not calibrated."""

    def __init__(self) -> None:
        super().__init__()
        self.lower = Port("lower", (1, 2))
        self.upper = Port("upper", (7,))
        self.hardware.ports = [self.lower, self.upper]
        self.searching: dict[tuple[str, int], str] = {}
        self.kept: list[tuple[int, bool, float]] = []
        self.calibrating: Any = SimpleNamespace(
            on=True,
            refusal=None,
            refusal_to_keep=self._refusal_to_keep,
            not_calibrating=self._not_calibrating,
        )
        homing: Any = SimpleNamespace(busy=lambda bus, id: self.searching.get((bus, id), ""))
        self.calls = DeviceCommands(self, homing, self.calibrating)
        self.tickets = 0

    def _refusal_to_keep(self, command: link.WriteRegister, kept: bool, now: float) -> CallFailure | None:
        self.kept.append((command.ticket, kept, now))
        return self.calibrating.refusal  # type: ignore[no-any-return]

    def _not_calibrating(self, command: link.WriteRegister) -> CallFailure:
        return CallFailure("WrongState", {"ticket": command.ticket})

    def tick(self) -> None:
        super().tick()
        for port in (self.lower, self.upper):
            port.serve()

    def send(self, kind: Any, **how: Any) -> int:
        """Begin a call on device 7, the only one of the upper bus."""
        self.tickets += 1
        begin: dict[Any, Callable[[Any, float], None]] = {
            link.ReadRegister: self.calls.read,
            link.WriteRegister: self.calls.write,
            link.Reboot: self.calls.reboot,
            link.Scan: self.calls.scan,
        }
        named = {} if kind is link.Scan else {"id": 7}
        named |= {"name": "led"} if kind in (link.ReadRegister, link.WriteRegister) else {}
        named |= {"value": 1} if kind is link.WriteRegister else {}
        how = {"ticket": self.tickets, "client": 4, "holder": "ann", "bus": "upper"} | named | how
        begin[kind](kind(**how), self.clock.now())
        return self.tickets

    def replies(self, ticket: int) -> list[link.Reply]:
        return [each for each in self.book.replies if each.ticket == ticket]

    def end(self, ticket: int) -> link.Reply:
        """The only reply to a call, once it has ended."""
        for _ in range(5 * ROUNDS):
            if self.replies(ticket):
                break
            self.tick()
        [reply] = self.replies(ticket)
        assert not reply.continues
        return reply

    def call(self, kind: Any, **how: Any) -> link.Reply:
        return self.end(self.send(kind, **how))

    def texts(self) -> list[tuple[str, str, str]]:
        return [(event.level, event.code, event.message) for event in self.book.events]
