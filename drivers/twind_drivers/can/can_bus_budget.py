"""Cycle of a CAN bus at a rate: frames, µs, Hz reachable; or a refusal."""

from collections import Counter
from dataclasses import dataclass

from twind.config.driver_family import BudgetRequest
from twind.config.robot_spec import BusSpec
from twind_drivers.can.can_cycle_budget import CanCycleBudget, budget
from twind_drivers.can.can_type import CanType


@dataclass(frozen=True, slots=True)
class CanBudget:
    """One CAN bus at one rate."""

    bus: BusSpec
    count: int
    rate_hz: float
    cycle: CanCycleBudget

    @property
    def refusal(self) -> str | None:
        """Why the rate is out of reach; None: it is not."""
        why = self.cycle.refusal(self.rate_hz)
        return None if why is None else f"bus {self.bus.name}: {why}"

    @property
    def lines(self) -> tuple[str, ...]:
        """For people: frames and time of a cycle, then the arithmetic."""
        each = self.cycle
        rate = f"{self.bus.baud} bit/s, {self.rate_hz:g} Hz wanted"
        return (
            f"bus {self.bus.name}: {self.count} CAN actuators at {rate}",
            f"  {each.frames:.3g} frames, {each.seconds * 1e6:.0f} us, up to {each.reachable_hz:.0f} Hz",
            *(f"    {line}" for line in each.lines),
        )


def can_budget(request: BudgetRequest) -> CanBudget:
    """Return the cycle of a CAN bus: goals, reading and upkeep."""
    families = Counter(joint.type.family for joint in request.joints if isinstance(joint.type, CanType))
    cycle = budget(families, request.bus.baud, request.rate_hz)
    return CanBudget(request.bus, len(request.joints), request.rate_hz, cycle)
