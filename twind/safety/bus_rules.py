"""Rules BUS_ERRORS, RX_SHAPE, FOREIGN_TRAFFIC and TX_BACKLOG: the traffic of each bus. Pure."""

from collections import deque
from collections.abc import Iterator, Sequence

from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import RobotState
from twind.safety.guard_types import (
    NOTHING,
    BusTraffic,
    GuardInput,
    GuardThresholds,
    Reaction,
    RuleResult,
    hold,
)

WINDOW = 1.0  # s of the window in which errors count; a single bad exchange must not stop a motion
ROUNDING = 1e-9  # of a share
REMEDY = (
    "on a robot check wiring, termination, power and baud rate; with virtual servos, end other programs that "
    "use the processor"
)


class BusErrorHistory:
    """Recent errors of one bus. A bus without errors costs nothing to remember."""

    def __init__(self) -> None:
        self.bad_in_a_row = 0
        self.full_in_a_row = 0
        self.foreign = 0
        self._bad: deque[float] = deque()  # s, each bad exchange within the window
        self._foreign: deque[tuple[float, int]] = deque()  # s and packets, within the window

    def add(self, traffic: BusTraffic, now: float) -> None:
        """Add one tick. A bus without a request in it gives no information about itself."""
        if traffic.asked:
            self.bad_in_a_row = self.bad_in_a_row + 1 if traffic.bad else 0
            if traffic.bad:
                self._bad.append(now)
        if traffic.full:
            self.full_in_a_row += traffic.full
        elif traffic.answered:  # what was sent has left
            self.full_in_a_row = 0
        if traffic.foreign:
            self._foreign.append((now, traffic.foreign))
            self.foreign += traffic.foreign
        while self._bad and not now - self._bad[0] < WINDOW:
            self._bad.popleft()
        if not self._bad:
            self.bad_in_a_row = 0  # without a request for so long it may be another bus by now
        while self._foreign and not now - self._foreign[0][0] < WINDOW:
            self.foreign -= self._foreign.popleft()[1]

    @property
    def blemished(self) -> bool:
        """True after a recent error; else a good tick changes nothing."""
        return bool(self._bad or self._foreign or self.bad_in_a_row or self.full_in_a_row)

    @property
    def bad(self) -> int:
        """Bad exchanges of the window."""
        return len(self._bad)


class BusRules:
    """Rules on the last second of each bus."""

    def __init__(self, names: Sequence[str], bounds: GuardThresholds) -> None:
        self._names = tuple(names)
        self._bounds = bounds
        self._records = tuple(BusErrorHistory() for _ in names)

    def judge(self, facts: GuardInput) -> Sequence[RuleResult]:
        """Return the faults of the buses. `facts.traffic` is in the order of their names."""
        if not facts.discarded:
            for record, each in zip(self._records, facts.traffic, strict=True):
                if each.bad or each.foreign or each.full or record.blemished:
                    break
            else:
                return NOTHING
        return tuple(self._found(facts))

    def _found(self, facts: GuardInput) -> Iterator[RuleResult]:
        if facts.discarded:
            message = f"{facts.discarded} bytes that belong to no request were dropped"
            yield RuleResult(Finding(ReasonCode.RX_SHAPE, value=float(facts.discarded), message=message))
        for bus, (record, traffic) in enumerate(zip(self._records, facts.traffic, strict=True)):
            if not (record.blemished or traffic.bad or traffic.foreign or traffic.full):
                continue
            record.add(traffic, facts.now)
            if record.bad:
                yield from self._errors(facts, bus, record)
            if record.foreign:
                yield from self._foreign(facts, bus, record.foreign)
            if record.full_in_a_row:
                yield self._full(facts, bus, record.full_in_a_row)

    def _errors(self, facts: GuardInput, bus: int, record: BusErrorHistory) -> Iterator[RuleResult]:
        """Yield BUS_ERRORS: a share of a second's exchanges, or several in a row.

        The fault changes no torque. On such a bus arming is refused.
        """
        bounds = self._bounds
        held = facts.torque_held
        reaction = hold(facts) if held else Reaction.NONE
        row = record.bad_in_a_row
        # share of as many exchanges as a second has
        share = record.bad * facts.period / WINDOW
        if row >= bounds.errors_row_fault:
            finding = self._row_finding(bus, row, bounds.errors_row_fault)
            yield RuleResult(finding, reaction, latches=held, bars=True, bus=bus)
        elif row >= bounds.errors_row_hold:
            finding = self._row_finding(bus, row, bounds.errors_row_hold)
            yield RuleResult(finding, reaction, bars=True, bus=bus)
        elif share >= bounds.errors_hold - ROUNDING and record.bad >= bounds.errors_least:
            finding = self._share_finding(bus, share, bounds.errors_hold)
            yield RuleResult(finding, reaction, bars=True, bus=bus)
        elif share >= bounds.errors_warn - ROUNDING:
            yield RuleResult(self._share_finding(bus, share, bounds.errors_warn), bus=bus)

    def _row_finding(self, bus: int, count: int, bound: int) -> Finding:
        return self._finding(bus, count, bound, f"{count} exchanges in a row failed (bound {bound})")

    def _share_finding(self, bus: int, share: float, bound: float) -> Finding:
        what = f"{100 * share:.3g} % of the exchanges of the last second failed (bound {100 * bound:.3g} %)"
        return self._finding(bus, share, bound, what)

    def _finding(self, bus: int, value: float, bound: float, what: str) -> Finding:
        message = f"bus {self._names[bus]}: {what}; {REMEDY}"
        return Finding(ReasonCode.BUS_ERRORS, value=float(value), bound=float(bound), message=message)

    def _foreign(self, facts: GuardInput, bus: int, count: int) -> Iterator[RuleResult]:
        """Yield FOREIGN_TRAFFIC: another master sends.

        Writing ends, since a servo cannot follow two masters.
        """
        bound = self._bounds.foreign
        if count < bound:
            return
        message = (
            f"bus {self._names[bus]}: {count} packets of the last second were not requested (bound {bound}); "
            "disconnect the other master, or the second servo with one id"
        )
        finding = Finding(ReasonCode.FOREIGN_TRAFFIC, value=float(count), bound=float(bound), message=message)
        if facts.torque_ours and facts.state is not RobotState.INHIBITED:
            yield RuleResult(finding, Reaction.INHIBIT, latches=True, bars=True, bus=bus)
        else:
            yield RuleResult(finding, bars=True, bus=bus)

    def _full(self, facts: GuardInput, bus: int, count: int) -> RuleResult:
        """Yield TX_BACKLOG: packets of this daemon do not leave the port, which has discarded them."""
        most = self._bounds.full
        many = count >= most
        bound = most if many else 1
        message = (
            f"bus {self._names[bus]}: its port had no room for {count} packets in a row (bound {bound}); "
            "check whether the adapter is stuck, or slower than its baud rate"
        )
        finding = Finding(ReasonCode.TX_BACKLOG, value=float(count), bound=float(bound), message=message)
        fault = many and facts.torque_held
        return RuleResult(finding, hold(facts) if fault else Reaction.NONE, latches=fault, bus=bus)
