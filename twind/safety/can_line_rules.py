"""Rule CAN_BUS_STATE: the state of each CAN bus on its wire. Pure.

A serial bus has no controller that could report this, so it is judged by its answers alone (`bus_rules`).
"""

from collections.abc import Collection, Iterator, Sequence

from twind.robot.finding import Finding, ReasonCode
from twind.safety.guard_types import (
    NOTHING,
    BusTraffic,
    GuardInput,
    GuardThresholds,
    Reaction,
    RuleResult,
    hold,
)

# values of `BusTraffic.line`: many errors; off the wire, or without acknowledgement
PASSIVE = 1
OFF = 2
ROUNDING = 1e-9  # s


class LineRules:
    """Rule CAN_BUS_STATE for the CAN buses. Counts for each bus the exchanges in a row without an answer."""

    def __init__(
        self, names: Sequence[str], can: Collection[str], free: bool, bounds: GuardThresholds
    ) -> None:
        """`can`: which of `names` are CAN buses. `free`: the robot stands freely, without support."""
        self._names = tuple(names)
        self._bounds = bounds
        self._free = free
        self._judged = tuple(place for place, name in enumerate(names) if name in can)
        self._unanswered = [0] * len(self._names)

    def judge(self, facts: GuardInput) -> Sequence[RuleResult]:
        """Return the faults of the CAN lines. `facts.traffic` is in the order of the bus names."""
        return tuple(self._found(facts)) if self._judged else NOTHING

    def _found(self, facts: GuardInput) -> Iterator[RuleResult]:
        for bus in self._judged:
            traffic = facts.traffic[bus]
            if traffic.line >= OFF:
                yield self._gone(
                    facts, bus, float(OFF), float(OFF), "off the wire, or no node acknowledges its frames"
                )
            elif traffic.line == PASSIVE:
                yield self._passive(bus)
            silent = self._silent(facts, bus, traffic)
            if silent is not None and traffic.line < OFF:
                yield self._gone(
                    facts, bus, silent, self._bounds.line_silent, "s without a reply of any node"
                )

    def _silent(self, facts: GuardInput, bus: int, traffic: BusTraffic) -> float | None:
        """Return the seconds without an answer, if they are a fault: each lost answer counts one period.

        A request that had no room in the port counts as lost too. The count begins anew on a bus that is not
        queried, or that holds no actuator up.
        """
        missed = traffic.full > 0 or (traffic.asked and not traffic.answered)
        self._unanswered[bus] = count = (
            self._unanswered[bus] + 1 if missed and _holds_actuator(facts, traffic) else 0
        )
        silent = count * facts.period
        enough = count >= self._bounds.errors_least and silent >= self._bounds.line_silent - ROUNDING
        return silent if enough else None

    def _passive(self, bus: int) -> RuleResult:
        message = (
            f"CAN bus {self._names[bus]} has so many errors that its controller is error passive: check "
            "termination (60 ohm between the wires), bit rate and wiring"
        )
        return RuleResult(
            Finding(ReasonCode.CAN_BUS_STATE, value=float(PASSIVE), bound=float(PASSIVE), message=message),
            bus=bus,
        )

    def _gone(self, facts: GuardInput, bus: int, value: float, bound: float, what: str) -> RuleResult:
        """Build the result of a bus without a receiver, where goals are not followed.

        Waiting frames must not leave later.
        """
        message = (
            f"CAN bus {self._names[bus]}: {what}: check the actuators' power, termination, bit rate and "
            "wiring; it is emptied and identified anew; then disarm, reset, arm"
        )
        finding = Finding(ReasonCode.CAN_BUS_STATE, value=value, bound=bound, message=message)
        if not _holds_actuator(facts, facts.traffic[bus]):
            return RuleResult(finding, bars=True, bus=bus)
        reaction = Reaction.SETTLE if self._free else hold(facts)
        return RuleResult(finding, reaction, latches=True, bars=True, bus=bus, gone=True)


def _holds_actuator(facts: GuardInput, traffic: BusTraffic) -> bool:
    """Check that torque of this daemon holds an actuator on this bus, or is about to.

    A bus given up before is lost already: to give it up again would stop the others on their way down.
    """
    return facts.torque_ours and not traffic.left_out
