"""History of calls and replies of clients, and a search for one order of events that explains it.

Each call has a beginning and an end; what happened lies between. So of a lease two spans are known: when its
holder *may* have held it, and when it *must* have. Nothing here is taken from the daemon but its answers.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf

# s that a lease lasts after the last call that keeps it (docs/protocol.md)
TERM = 1.0
STREAMING = 0.25
KEEPS = {"AcquireLease": TERM, "RenewLease": TERM, "SubmitTrajectory": TERM, "Setpoint": STREAMING}
NEEDS = frozenset({"RenewLease", "SubmitTrajectory", "Setpoint", "Arm"})  # obeyed: it held the lease
NO_SIGN = frozenset({"ok", "LEASE_MISSING", "LeaseHeld"})  # refused before it could keep anything, or obeyed
ENDS = frozenset({"succeeded", "cancelled", "replaced", "aborted"})


@dataclass
class Op:
    """One call. `end` is inf and `result` `lost` where no answer can come any more."""

    client: int
    name: str
    begin: float  # s
    end: float = inf
    result: str = ""  # "": not answered yet; ok, lost, else the error or the first code of a refusal
    take: bool = False
    more: bool = False
    motion: str = ""  # id of the motion that a submission began
    kept: float = inf  # s, when a followed motion ended; inf: not yet
    fate: str = ""  # how that motion ended
    codes: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        return self.result == "ok"


@dataclass
class Span:
    """One holding of the lease."""

    client: int
    may_begin: float
    must_begin: float
    may_end: float = inf
    must_end: float = inf
    ops: list[Op] = field(default_factory=list)


@dataclass
class History:
    """Calls of all clients, connections that closed, and deaths that closed all of them (s)."""

    ops: list[Op] = field(default_factory=list)
    gone: dict[int, float] = field(default_factory=dict)
    deaths: list[float] = field(default_factory=list)
    slack: float = 0.011  # s: one tick, in which a lapse is noticed

    def spans(self) -> list[Span]:
        """Every holding, with the time it may and the time it must have lasted."""
        spans = []
        for client in dict.fromkeys(op.client for op in self.ops):
            spans += self._spans(client)
        return spans

    def _spans(self, client: int) -> list[Span]:
        ops = [op for op in self.ops if op.client == client and op.ok]
        found: list[Span] = []
        for op in sorted(ops, key=lambda op: op.begin):
            # A call that needs the lease proves that it never lapsed before; taking it again does not.
            if op.name == "AcquireLease" and not (found and op.end <= found[-1].must_end):
                if found:
                    found[-1].may_end = min(found[-1].may_end, op.end)
                found.append(Span(client, op.begin, op.end))
                found[-1].ops.append(op)
                self._bound(found[-1])
            elif found and op.name in (*KEEPS, "ReleaseLease") and op.begin <= found[-1].may_end:
                found[-1].ops.append(op)
                self._bound(found[-1])
        return found

    def _bound(self, span: Span) -> None:
        """From the calls that kept it, the one that gave it back, and what ended it from outside."""
        span.may_end = span.must_end = -inf
        for op in span.ops:
            if op.name == "ReleaseLease":
                span.may_end = min(span.may_end, op.end)
                span.must_end = min(span.must_end, op.begin)
                break
            self._keep(span, op)
        for moment in (self.gone.get(span.client, inf), *self.deaths):
            if moment >= span.may_begin:
                span.must_end = min(span.must_end, moment)
                span.may_end = min(span.may_end, moment + self.slack)
        for op in self.ops:
            if op.client != span.client and op.name == "AcquireLease" and op.take:
                self._taken(span, op)

    def _taken(self, span: Span, op: Op) -> None:
        """Another took it, or may have. A call that overlaps the one that began the span happened before it
        or after it: before, if its holder was obeyed in a call that began later. Else nobody knows."""
        if op.end < span.may_begin or op.begin > span.must_end:
            return
        after = op.begin >= span.must_begin
        if not after and any(each.begin >= op.end for each in span.ops if each.name in NEEDS):
            return
        span.must_end = min(span.must_end, op.begin)
        if after and op.ok:
            span.may_end = min(span.may_end, op.end + self.slack)

    def _keep(self, span: Span, op: Op) -> None:
        """One call that was obeyed: it lasts for a term; an open one until its end, and a term more."""
        span.may_end = max(span.may_end, op.end + KEEPS[op.name] + self.slack)
        held = [each.kept for each in span.ops if each.more and each.begin <= op.begin < each.kept]
        if op.more:
            span.may_end = max(span.may_end, op.kept + TERM + self.slack)
        span.must_end = max([op.begin + KEEPS[op.name], *held])
        for other in self.ops:  # what was refused for another reason may have been a sign of life before
            if other.client != span.client or other.name not in KEEPS or other.result in NO_SIGN:
                continue
            if op.begin <= other.begin <= span.may_end:
                span.may_end = max(span.may_end, other.end + TERM + self.slack)
                if other.name == "Setpoint" and not held:
                    span.must_end = min(span.must_end, max(other.begin + STREAMING, op.begin))

    # ----------------------------------------------------------------------- what must be true

    def wrong(self) -> list[str]:
        """Everything that no order of events explains."""
        spans = self.spans()
        return [*_two_holders(spans), *self._rights(spans), *self._fates()]

    def _rights(self, spans: Sequence[Span]) -> list[str]:
        """An obeyed client may have held the lease; one refused with LEASE_MISSING need not have."""
        found = []
        for op in self.ops:
            if op.name not in NEEDS or op.result in ("", "lost"):
                continue
            own = [span for span in spans if span.client == op.client]
            may = any(span.may_begin <= op.end and op.begin <= span.may_end for span in own)
            must = any(span.must_begin <= op.begin and op.end <= span.must_end for span in own)
            if op.ok and not may:
                found.append(f"obeyed without the lease: {op}")
            if op.result == "LEASE_MISSING" and must:
                found.append(f"refused although it held the lease: {op}")
        return found

    def _fates(self) -> list[str]:
        """H1: what was acknowledged is executed, or told to have ended with a reason, or died visibly."""
        found = []
        for op in self.ops:
            if op.name != "SubmitTrajectory" or not op.ok or op.fate == "lost":
                continue
            if op.fate not in ENDS:
                found.append(f"acknowledged and never told of again: {op}")
            if op.fate == "aborted" and not op.codes:
                found.append(f"aborted without a code: {op}")
        ids = [op.motion for op in self.ops if op.name == "SubmitTrajectory" and op.ok]
        found += [f"one id for two motions: {id}" for id in set(ids) if ids.count(id) > 1]
        return found

    def unanswered(self, now: float, patience: float) -> list[str]:
        """Calls that somebody still waits for, for longer than anybody should."""
        waiting = [op for op in self.ops if not op.result and now - op.begin > patience]
        return [f"not answered within {patience} s: {op}" for op in waiting]


def _two_holders(spans: Sequence[Span]) -> list[str]:
    """H2: two clients that both must have held it at one moment."""
    found = []
    for place, one in enumerate(spans):
        for other in spans[place + 1 :]:
            begin = max(one.must_begin, other.must_begin)
            end = min(one.must_end, other.must_end)
            if one.client != other.client and begin < end:
                found.append(f"two holders from {begin:.3f} to {end:.3f} s: {one.client} and {other.client}")
    return found
