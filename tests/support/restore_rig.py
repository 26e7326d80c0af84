"""A search that is over, and its servo on a scripted bus, not restored yet."""

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from tests.support.procedure_rig import PERIOD, BusTask, ProcedureRig
from twind import link
from twind.loop.procedures.homing_restore import EndstopSearchRecord, give_back
from twind.robot.finding import Finding
from twind.safety.multiturn import StatedPlace
from twind.safety.state_machine import RobotEvent
from twind_drivers.bus import IdentifiedDevice

KNEE = 1
TURN = 4096
REST = 700  # count
WAS = IdentifiedDevice(2, 1020, "XM430-W350", 45, {"drive_mode": 0, "homing_offset": 3}, "a")


class OneServo:
    """Port, writer and single device of one servo; `errors`: of its attempts in turn, then none."""

    def __init__(self, rig: ProcedureRig) -> None:
        self.rig = rig
        self.errors: list[Exception] = []
        self.attempts: list[float] = []  # s
        self.log: list[str] = []
        self.devices: tuple[IdentifiedDevice, ...] = (WAS,)
        self.identification: Any = None
        self.full = False
        self.writer: Any = self
        self.reader: Any = object()
        self.ticks = 2  # of an attempt

    def begin_single_device(self, id: int, **how: int) -> Any:
        self.log.append("alone")
        if self.errors and type(self.errors[0]) is ValueError:
            self.attempts.append(self.rig.clock.now())
            raise self.errors.pop(0)
        assert (id, how) == (2, {"cap": 20, "profile": 5})
        return self

    def end_single_device(self) -> None:
        self.log.append("all")

    def give_back(self, kept: Any) -> str:
        assert kept == "kept"
        return "give back"

    def run(self, script: str) -> Any:
        self.log.append(script)
        self.attempts.append(self.rig.clock.now())
        task: Any = Attempt(self.ticks)
        task.error = self.errors.pop(0) if self.errors else None
        return task

    def identify(self) -> None:
        self.log.append("identify")
        self.rig.hardware.connected = False


class Attempt(BusTask):
    """A script that is done after some looks."""

    def __init__(self, looks: int) -> None:
        self._looks = looks
        super().__init__()

    @property
    def done(self) -> bool:  # type: ignore[override]
        self._looks -= 1
        return self._looks < 0

    @done.setter
    def done(self, value: bool) -> None: ...


class Turns:
    """Turns of three joints: a place chooses one after `takes` looks."""

    def __init__(self, takes: int = 3) -> None:
        self.takes = takes
        self.places: dict[int, StatedPlace] = {}
        self.against: Finding | None = None
        self.withdrawn: list[Sequence[int]] = []

    def locate(self, joint: int, place: StatedPlace) -> Finding | None:
        self.places[joint] = place
        return self.against

    @property
    def turn_known(self) -> Any:
        self.takes -= bool(self.places)
        return np.array([False, self.takes < 0, False])

    def withdraw(self, joints: Sequence[int]) -> list[int]:
        self.withdrawn.append(joints)
        return []


class Restoring:
    """A search that is over, its servo not restored yet; torque is off."""

    def __init__(self, **how: Any) -> None:
        self.rig = ProcedureRig()
        self.servo = OneServo(self.rig)
        self.turns = Turns()
        request: Any = SimpleNamespace(joint=KNEE, port=self.servo, id=2, cap=20, profile=5, turn=TURN)
        command = link.FindStop(ticket=4, client=7, joint=KNEE, side="lower", more=True)
        how = {"captures": [10.4, 11.6]} | how
        self.pending = EndstopSearchRecord(command, request, WAS, kept="kept", left="mode 5", **how)
        self.pending.over = True
        self.restored = 0
        self.count = REST
        self.heard: Callable[[float], float] = lambda now: now
        self.rig.hardware.readings.raw.heard_at = np.zeros(3)
        self.rig.watched = self.read
        self.rig.condition.change(RobotEvent.CALIBRATE)
        self.rig.book.events.clear()
        self.read()

    def read(self) -> None:
        raw = self.rig.hardware.readings.raw
        raw.ticks[:] = self.count
        raw.heard_at[:] = self.heard(self.rig.clock.now())

    def begin(self) -> None:
        def done() -> None:
            self.restored += 1

        steps = give_back(self.rig, self.pending, self.turns, done)  # type: ignore[arg-type]
        self.rig.procedures.beside(steps)

    def seconds(self, seconds: float) -> None:
        self.rig.ticks(round(seconds / PERIOD))

    @property
    def replies(self) -> list[dict[str, Any]]:
        return [reply.parameters for reply in self.rig.book.replies]

    def codes(self) -> list[str]:
        [reply] = self.replies
        return [each.code for each in reply.get("findings") or ()]

    def events(self) -> list[tuple[str, str]]:
        return [(event.level, event.message) for event in self.rig.book.events]
