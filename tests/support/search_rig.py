"""An end-stop search of one joint, tick by tick: its servo on a scripted bus turns a shaft against a stop.

Real search, states, torque, lease and restoring. Each request is done a tick later; a test orders which one
fails, and what happens in its tick.
"""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.procedure_rig import PERIOD, BusTask, ProcedureRig
from tests.support.restore_rig import KNEE, TURN, WAS, Turns
from twind import link
from twind.loop.bus.bus_port import BusPort
from twind.loop.procedures import homing_procedure
from twind.loop.procedures.homing_procedure import HomingProcedure
from twind.loop.procedures.homing_request import HomingRequest
from twind.loop.tick.loop_parts import LoopParts
from twind.motion.endstop_search import HomingParameters
from twind.robot.finding import Finding
from twind.safety.lease import Lease
from twind.safety.state_machine import RobotEvent
from twind_drivers.bus import WireRangeError

CLIENT = 7
ID = 2
CAP = 40  # raw
WATCHDOG = 5
START = 1300  # count
STOP = 1010  # count, where the shaft is blocked
EXPECTED = 1000  # count, where the stop should be
MARGIN = 130
LOWER = 860  # count: the goals that may be sent
UPPER = 1500
OTHER_MODE = TURN  # counts that the servo reports more in its current mode


class OneSearchedServo:
    """Port, writer and single device of one servo, and its shaft.

    `log`: what was asked of it; `failing`: the error of a request, by name; `during`: called when it is
    asked.
    """

    def __init__(self, rig: ProcedureRig) -> None:
        self.rig = rig
        self.name = "lower"
        self.log: list[str] = []
        self.failing: dict[str, Exception] = {}
        self.during: dict[str, Callable[[], Any]] = {}
        self.hurried: list[bool] = []  # of each request
        self.devices: tuple[Any, ...] = (replace(WAS, id=1, model_number=1030), WAS)
        self.identification: Any = None
        self.full = self.busy = self.holding = False
        self.trouble = ""
        self.writer: Any = self
        self.reader: Any = object()
        self.id = ID
        self.watchdog = WATCHDOG
        self.bounds: tuple[int, int] | None = None  # raw: goals that may be sent
        self.goals: list[int] = []  # raw, in each tick
        self.goal_count: float = START  # raw
        self.count: float = START  # of the shaft, in the usual mode
        self.stop: float = STOP
        self.offset = 0  # counts that the present mode reports more
        self.other = OTHER_MODE
        self.torque = False
        self.strength = CAP  # raw effort that it uses at most
        self.limp: Callable[[float], float] = lambda count: count  # moves the shaft without torque, each tick
        self.alone = False

    # ------------------------------------------------------------------------------- port and writer

    def run(self, script: str, *, urgent: bool = False) -> Any:
        self.log.append(script)
        self.hurried.append(urgent)
        task = BusTask(self.failing.get(script), "kept" if script == "look" else None)  # type: ignore[arg-type]
        self.rig.hardware.tasks.append(task)
        self.during.get(script, lambda: None)()
        if task.error is None:
            self._carry_out(script)
        return task

    def _carry_out(self, script: str) -> None:
        if script == "current mode":
            self.offset = self.other
        elif script == "energise":
            self.torque = True
            self.rig.hardware.slow.watchdog[KNEE] = WATCHDOG
        elif script == "give back":
            self.offset = 0
            self.torque = False

    def begin_single_device(self, id: int, *, cap: int, profile: int) -> Any:
        assert (id, cap, profile) == (ID, CAP, 5)
        self.log.append("alone")
        self.alone = True
        return self

    def end_single_device(self) -> None:
        self.log.append("all")
        self.alone = False

    def cut(self) -> None:
        self.log.append("cut")

    def identify(self) -> None:
        self.log.append("identify")

    # ------------------------------------------------------------------------------- single device

    def look(self) -> str:
        return "look"

    def describe_leftovers(self, kept: Any) -> str:
        assert kept == "kept"
        return "mode 5"

    def enter_current_mode(self, kept: Any) -> str:
        assert kept == "kept"
        return "current mode"

    def set_goal_limits(self, lower: int, upper: int) -> None:
        self.bounds = (lower, upper)

    def prepare(self, kept: Any, tick: int) -> str:
        assert kept == "kept"
        self.goal_count = tick
        self.goals.append(tick)
        return "prepare"

    def energise(self) -> str:
        return "energise"

    def goal(self, tick: int) -> None:
        if "goal" in self.failing:
            raise self.failing["goal"]
        assert self.bounds is not None
        if not self.bounds[0] <= tick <= self.bounds[1]:
            raise WireRangeError(self.name, ID, tick, *self.bounds)
        self.goals.append(tick)
        self.goal_count = tick

    def give_back(self, kept: Any) -> str:
        assert kept == "kept"
        return "give back"

    # ------------------------------------------------------------------------------- its shaft

    def move(self) -> float:
        """One period; return the effort, raw."""
        if not self.torque:
            self.count = self.limp(self.count)
            return 0.0
        wanted = self.goal_count - self.offset
        self.count = max(wanted, self.stop)
        return float(min(self.strength, abs(self.count - wanted)))


class Search:
    """A calibrated robot on which a client may search the stop of its knee; everything is limp."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.rig = ProcedureRig()
        self.servo = OneSearchedServo(self.rig)
        self.turns: Any = Turns()
        self.turns.unrestored = None
        self.lease = Lease()
        self.guard = SimpleNamespace(bars=())
        self.hears = True
        hardware = self.rig.hardware
        hardware.ports[0] = self.servo
        hardware.ports[1].busy = False
        hardware.writers = [self.servo]
        hardware.slow.fault = np.zeros(3, np.int16)
        hardware.readings.raw.heard_at = np.zeros(3)
        hardware.readings.raw.effort = np.zeros(3)
        self._torque = hardware.torque
        hardware.torque = self._switch
        self.rig.watched = self.read
        self.rig.condition.change(RobotEvent.CALIBRATE)
        self.rig.book.events.clear()
        parts: Any = SimpleNamespace(lease=self.lease, guard=self.guard)
        self.homing = HomingProcedure(self.rig, of_parts(parts), None, self.turns)  # type: ignore[arg-type]
        self.request: HomingRequest | list[Finding] = self.described()
        patch.setattr(homing_procedure, "resolve_request", lambda *_: self.request)
        self.lease.acquire(CLIENT, "calibrate", 1000, self.rig.clock.now())
        self.read()

    def described(self, *, turn_unknown: bool = False, **how: Any) -> HomingRequest:
        """The request in counts, once it is allowed."""
        search = HomingParameters(
            way=-1,
            expected=EXPECTED,
            margin=MARGIN,
            speed=500.0,
            cap=CAP,
            back=80.0,
            lead=130.0,
            astray=98.0,
            still=4.0,
            times=2,
            turn=float(TURN) if turn_unknown else 0.0,
            away=80.0 if turn_unknown else 0.0,
        )
        port: Any = self.servo
        usual: dict[str, Any] = {
            "joint": KNEE,
            "port": as_port(port),
            "id": ID,
            "search": search,
            "lower": LOWER,
            "upper": UPPER,
            "turn": TURN,
            "jump": 30.0,
            "profile": 5,
            "cap": CAP,
            "shift": 0,
        }
        return HomingRequest(**(usual | how))

    def _switch(self, on: bool) -> Any:
        asked = self._torque(on)
        self.servo.log.append(f"torque {on}")
        self.servo.during.get(f"torque {on}", lambda: None)()
        if asked[0].error is None:
            self.servo.torque = on
        return asked

    def read(self) -> None:
        """The readings of the last period."""
        effort = self.servo.move()
        now = self.rig.clock.now()
        slow = self.rig.hardware.slow
        slow.torque[KNEE] = self.servo.torque
        slow.status_time[:] = now - 0.002
        if self.hears:
            raw = self.rig.hardware.readings.raw
            raw.ticks[KNEE] = round(self.servo.count + self.servo.offset)
            raw.effort[KNEE] = effort
            raw.heard_at[KNEE] = now - 0.002

    def ask(self, *, more: bool = False, client: int = CLIENT) -> None:
        """Ask for a search."""
        command = link.FindStop(
            ticket=4, client=client, holder="calibrate", joint=KNEE, side="lower", more=more
        )
        self.homing.ask(command, self.rig.clock.now())

    def until(self, done: Callable[[], Any], seconds: float = 10.0) -> None:
        """Tick until then."""
        for _ in range(round(seconds / PERIOD)):
            if done():
                return
            self.rig.tick()
        raise AssertionError(f"never; asked: {self.servo.log}; replies: {self.replies}")

    def until_asked(self, name: str) -> None:
        """Until this was asked of the servo."""
        self.until(lambda: name in self.servo.log)

    def until_moving(self) -> None:
        """Until the search sends goals."""
        self.until(lambda: self.homing.unrestored is not None and self.homing.unrestored.powered is not None)
        self.rig.ticks(10)

    def until_answered(self) -> dict[str, Any]:
        """Until the last reply; its parameters."""
        self.until(lambda: self.last)
        [reply] = self.last
        assert reply.error is None, reply
        return dict(reply.parameters)

    @property
    def last(self) -> list[link.Reply]:
        """The last reply, once it is there."""
        return [reply for reply in self.rig.book.replies if not reply.continues]

    @property
    def replies(self) -> list[dict[str, Any]]:
        return [dict(reply.parameters) for reply in self.rig.book.replies]

    def findings(self) -> list[Finding]:
        """Findings of a search that failed; afterwards torque is off and everything is restored."""
        parameters = self.until_answered()
        assert parameters["phase"] == "failed" and "ticks" not in parameters, parameters
        self.rig.ticks(30)
        assert not self.servo.torque and not self.rig.torque.energising
        assert self.servo.offset == 0 and not self.servo.alone
        assert self.homing.unrestored is None and self.turns.unrestored is None
        assert self.homing.busy() == ""
        return list(parameters["findings"])


def of_parts(parts: Any) -> LoopParts:
    """Parts of a loop, as far as a search uses them."""
    return parts  # type: ignore[no-any-return]


def as_port(port: Any) -> BusPort:
    """A scripted port in place of a real one."""
    return port  # type: ignore[no-any-return]
