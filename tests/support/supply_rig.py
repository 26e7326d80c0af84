"""Supply control alone, beside a power process that the test plays."""

from dataclasses import dataclass, field
from math import inf, nan

import numpy as np

from tests.support.gate_rig import ratings
from tests.support.procedure_rig import NAMES, ProcedureRig
from twind.config.power_config import ButtonSpec, RelaySpec
from twind.loop.procedures.supply_control import SupplyControl
from twind.power.power_states import ButtonState, RelayState
from twind.power.supply_sequence import MORE
from twind.robot.finding import Finding, ReasonCode

FALL = 1.0
LOW = 9.5  # V, of the joints that have a bound
EPSILON = 1e-6


@dataclass(eq=False)
class Child:
    """Power process: the test sets its states, and finds what it was told."""

    relay_spec: RelaySpec | None = None
    button_spec: ButtonSpec | None = None
    pid: int | None = 4
    relay: RelayState = RelayState.OPEN
    button: ButtonState = ButtonState.RELEASED
    trouble: str = ""
    supervised: list[float] = field(default_factory=list)
    wanted: list[bool] = field(default_factory=list)
    closed: int = 0

    def supervise(self, now: float) -> None:
        self.supervised.append(now)

    def beat(self, wanted: bool) -> None:
        self.wanted.append(wanted)

    def close(self) -> None:
        self.closed += 1


class Supply(ProcedureRig):
    """Live, connected and without torque; no device reports a supply. Time passes as the test says."""

    def __init__(self, *, relay: bool = True, level: str | None = "settle") -> None:
        super().__init__()
        count = len(NAMES)
        self.child = Child()
        if relay:
            self.child.relay_spec = RelaySpec("lcus1", "relay", -1, False, 0.1, FALL)
        if level is not None:
            self.child.button_spec = ButtonSpec("serial", "button", level, -1, -1)
        self.stops: list[tuple[str, str]] = []
        self.hardware.slow.voltage = np.full(count, nan)
        self.hardware.slow.health_time = np.full(count, -inf)
        found = ratings(count)
        object.__setattr__(found, "low_fault", np.array([LOW, LOW, nan]))
        object.__setattr__(self.robot.description, "ratings", found)
        self.control = SupplyControl(self, self.child, self.begin_stop)  # type: ignore[arg-type]

    def begin_stop(self, level: str, reason: str) -> None:
        """Latch the e-stop that is asked for, as a daemon does."""
        self.stops.append((level, reason))
        self.condition.latch(Finding(ReasonCode.ESTOP, message=reason))

    def serve(self, passed: float = 0.0) -> None:
        """The next tick comes `passed` s after the last one."""
        self.clock.sleep_until(self.clock.now() + passed)
        self.control.serve(self.clock.now())

    def supply(self, *volts: float, age: float = 0.0) -> None:
        """Devices report these voltages from `age` s ago."""
        self.hardware.slow.voltage[:] = volts
        self.hardware.slow.health_time[:] = self.clock.now() - age

    def press(self, state: ButtonState = ButtonState.PRESSED) -> None:
        self.child.button = state
        self.serve(0.01)

    def wanted(self) -> bool:
        """The order of the relay that the process gets with a beat."""
        self.control.beat()
        return self.child.wanted[-1]

    def close_relay(self) -> None:
        """The relay was open long enough, and closes; a supply comes."""
        self.serve()
        self.serve(FALL + MORE)
        assert self.wanted()
        self.child.relay = RelayState.CLOSED
        self.supply(12.0, 12.0, 12.0)
        self.serve(0.01)

    def faults(self) -> list[str]:
        return [each.message for each in self.control.findings]
