"""Order of the supply relay over time, and whether the supply follows it. Pure; runs in the loop."""

from dataclasses import dataclass
from enum import StrEnum
from math import inf

from twind.power.power_states import RelayState

COMES = 5.0  # s that a closed relay may take to bring the supply: devices boot and are identified
BROKEN = (RelayState.UNKNOWN, RelayState.TRIPPED, RelayState.FAILED)  # closed anew only after a fall
MORE = 0.5  # s that the relay stays open beyond the fall of the supply, in which the fall is confirmed


class SupplyFault(StrEnum):
    """Fault of the relay or of its effect."""

    STAYS = "stays"  # the relay is open, and devices still report a supply
    MISSING = "missing"  # the relay is closed, and no device reports a supply
    TRIPPED = "tripped"  # the relay opened since ticks were missing
    FAILED = "failed"  # the relay's device cannot be used
    ABSENT = "absent"  # the power process does not run


@dataclass(frozen=True, slots=True)
class SupplyInput:
    """Input of one step."""

    relay: RelayState  # UNKNOWN: the power process does not report
    may_close: bool  # no torque is held, no procedure runs, and the button is released
    must_open: bool  # a stop by the button, or mode sim
    powered: bool | None  # a device reports a supply; None: not known


class SupplySequence:
    """Relay that is open for a while before it closes, and closes only on a robot without torque."""

    def __init__(self, fall: float) -> None:
        """`fall`: s after which the supply is gone behind an open relay."""
        self.wanted = False  # the relay is to be closed
        self.fault: SupplyFault | None = SupplyFault.ABSENT
        self._fall = fall
        self._state = RelayState.UNKNOWN
        self._since = inf  # s, when the relay came into its state
        self._powered_once = False  # since the relay was closed

    def step(self, now: float, given: SupplyInput) -> None:
        """Work out `wanted` and `fault` for this tick."""
        if given.relay is not self._state:
            self._state = given.relay
            self._since = now
            self._powered_once = False
        lasted = now - self._since
        self.fault = self._judge(given, lasted)
        if given.must_open or given.relay in BROKEN:
            self.wanted = False
        elif given.relay is RelayState.OPEN and self.fault is None and given.may_close:
            self.wanted = lasted >= self._fall + MORE

    def _judge(self, given: SupplyInput, lasted: float) -> SupplyFault | None:
        if given.relay is RelayState.UNKNOWN:
            return SupplyFault.ABSENT
        if given.relay is RelayState.FAILED:
            return SupplyFault.FAILED
        if given.relay is RelayState.TRIPPED:
            return SupplyFault.TRIPPED
        if given.relay is RelayState.OPEN:
            return SupplyFault.STAYS if given.powered and lasted >= self._fall else None
        self._powered_once = self._powered_once or given.powered is not False
        return SupplyFault.MISSING if not self._powered_once and lasted >= COMES else None
