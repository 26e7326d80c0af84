"""Supply relay and stop button: order of the relay, its measured effect, e-stop. Loop's process."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import inf
from types import MappingProxyType

import numpy as np

from twind.loop.procedures.procedure_context import ProcedureContext
from twind.loop.procedures.procedure_runner import Priority
from twind.loop.process.power_child import PowerChild
from twind.power.power_states import ButtonState, RelayState
from twind.power.supply_sequence import COMES, SupplyFault, SupplyInput, SupplySequence
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode

FRESH = 0.5  # s: a reading of the supply counts for so long
LEAST = 3.0  # V of a joint without a bound of its own: no supply is lower
LOOK = 0.1  # s between two looks at the measured supply
CUT_WITHIN = 0.2  # s after the button at level `cut`: the relay opens, whether torque is read back or not
STARTS = 5.0  # s after which a button that was never read counts as unplugged ...
LOST = 2.0  # ... and one that is read no longer, as its process is started anew
STOPPING = (Priority.ESTOP, Priority.CUT)
BUTTON_TEXT: Mapping[ButtonState, str] = MappingProxyType(
    {
        ButtonState.PRESSED: "the stop button is pressed",
        ButtonState.UNPLUGGED: "the stop button is unplugged or cannot be read",
        ButtonState.UNKNOWN: "the stop button is not read",
    }
)
FAULT_TEXT: Mapping[SupplyFault, str] = MappingProxyType(
    {
        SupplyFault.STAYS: "V, the supply stays while the relay is open: check its wiring and contact",
        SupplyFault.MISSING: "s since the relay closed, and no device reports a supply: check its fuse",
        SupplyFault.TRIPPED: "the relay opened: the loop did not complete a tick in time",
        SupplyFault.FAILED: "the relay cannot be used",
        SupplyFault.ABSENT: "the process of the relay does not run",
    }
)


class SupplyControl:
    """Relay and button of one robot; without both nothing happens."""

    def __init__(
        self, context: ProcedureContext, child: PowerChild | None, stop: Callable[[str, str], None]
    ) -> None:
        """`stop`: begins an e-stop of a level, for a reason."""
        self._context = context
        self._child = child
        self._stop = stop
        relay = None if child is None else child.relay_spec
        self._sequence = None if relay is None else SupplySequence(relay.fall)
        self._button = None if child is None else child.button_spec
        self._stopped_at: float | None = None  # s, of the stop by the button in force; None: none is
        self._known_until = inf  # s: until then an unknown button is no reason to stop
        self._patience = STARTS
        self._looked_at = -inf
        self._powered: bool | None = None
        self._reported: SupplyFault | None = SupplyFault.ABSENT  # a start is no fault
        self.relay = RelayState.UNKNOWN
        self.button = ButtonState.UNKNOWN

    @property
    def findings(self) -> list[Finding]:
        """Findings that prevent arming and motion."""
        if self._context.condition.mode is Mode.SIM:
            return []
        found = []
        if self._sequence is not None and self._sequence.fault is not None:
            found.append(self._finding(self._sequence.fault))
        if self._button is not None and self.button is ButtonState.UNKNOWN:
            found.append(Finding(ReasonCode.HW_DISCONNECTED, message=BUTTON_TEXT[ButtonState.UNKNOWN]))
        return found

    @property
    def relay_text(self) -> str | None:
        """State of the relay for clients; None: there is none."""
        return None if self._sequence is None else self.relay.name.lower()

    @property
    def button_text(self) -> str | None:
        """State of the button for clients; None: there is none."""
        return None if self._button is None else self.button.name.lower()

    def beat(self) -> None:
        """Note a completed tick."""
        if self._child is not None:
            self._child.beat(self._sequence is not None and self._sequence.wanted)

    def close(self) -> None:
        """End the process; the relay opens."""
        if self._child is not None:
            self._child.close()

    def serve(self, now: float) -> None:
        """Take in the states of relay and button, and act on them; called before commands are served."""
        child = self._child
        live = self._context.condition.mode is not Mode.SIM
        if child is None or (not live and child.pid is None):
            return
        child.supervise(now)
        self.relay = child.relay
        self._watch_button(now, child.button, live)
        if self._sequence is not None:
            self._order(now, self._sequence, live)

    # ------------------------------------------------------------------------------- button

    def _watch_button(self, now: float, state: ButtonState, live: bool) -> None:
        """Begin an e-stop when the button is pressed or gone; keep it until the button is released."""
        if self._button is None:
            return
        before = self.button
        self.button = state
        if state is ButtonState.UNKNOWN:
            self._known_until = min(self._known_until, now + self._patience)
        else:
            self._known_until = inf
            self._patience = LOST
        stops = state in (ButtonState.PRESSED, ButtonState.UNPLUGGED) or now > self._known_until
        if ReasonCode.ESTOP not in self._context.condition.latches:
            self._stopped_at = None
        if live and stops and (self._stopped_at is None or state is not before):
            reason = BUTTON_TEXT[state]
            finding = Finding(ReasonCode.ESTOP, message=reason)
            self._context.reports.event("error", ReasonCode.ESTOP, reason, (finding,))
            self._stopped_at = now
            self._stop(self._button.level, reason)

    # ------------------------------------------------------------------------------- relay

    def _order(self, now: float, sequence: SupplySequence, live: bool) -> None:
        context = self._context
        idle = not context.torque.armed and context.procedures.rank is None
        released = self._button is None or self.button is ButtonState.RELEASED
        if now - self._looked_at >= LOOK:
            self._looked_at = now
            self._powered = self._measure_supply(now)
        # A relay that is open stays open during a stop, also one that is ordered to close and has not yet:
        # behind it no torque can be read off any more.
        stays = self.relay is RelayState.OPEN and self._stopped_at is not None
        opens = not live or stays or self._is_stop_over(now)
        sequence.step(now, SupplyInput(self.relay, idle and released, opens, self._powered))
        if sequence.fault is not self._reported:
            self._reported = sequence.fault
            context.reports.urgent = True
            if live and sequence.fault is not None:
                finding = self._finding(sequence.fault)
                context.reports.event("error", finding.code, finding.message, (finding,))

    def _is_stop_over(self, now: float) -> bool:
        """Return True if a stop by the button has ended with all torque read off, so that the supply may go.

        A stop that could not run, as on a bus that is lost, has not lowered the robot.
        """
        if self._stopped_at is None or self._button is None:
            return False
        late = self._button.level == "cut" and now - self._stopped_at >= CUT_WITHIN
        down = bool((self._context.hardware.slow.torque == 0).all())
        return late or (down and self._context.procedures.rank not in STOPPING)

    def _measure_supply(self, now: float) -> bool | None:
        """Return whether a device reports a supply; None: not known."""
        hardware = self._context.hardware
        slow = hardware.slow
        fresh = now - slow.health_time <= FRESH
        if not hardware.open.any():
            return None
        if not fresh.any():
            return False
        volts = slow.voltage[fresh]
        known = np.isfinite(volts)
        return bool((volts[known] >= self._bounds()[fresh][known]).any()) if known.any() else None

    def _bounds(self) -> np.ndarray:
        """Return the voltage (n,) from which on a joint counts as supplied, V."""
        low = self._context.robot.description.ratings.low_fault
        return np.where(np.isfinite(low), low, LEAST)

    def _finding(self, fault: SupplyFault) -> Finding:
        value = bound = None
        message = FAULT_TEXT[fault]
        if fault is SupplyFault.STAYS:
            value = float(np.nan_to_num(self._context.hardware.slow.voltage, nan=0.0).max())
            bound = float(self._bounds().min())
        elif fault is SupplyFault.MISSING:
            value = bound = COMES
        elif fault is SupplyFault.FAILED and self._child is not None and self._child.trouble:
            message = f"{message}: {self._child.trouble}"
        return Finding(ReasonCode.SUPPLY_RELAY, value=value, bound=bound, message=message)
