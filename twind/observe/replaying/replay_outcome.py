"""Results of the commands: answers in the order of the calls, faults that stayed, the state at the end. Pure.

Built from the loop's own messages, or from those that a client receives; two of them are compared here.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from twind.robot.modes import RESET_STATES

ENDED = ("succeeded", "cancelled", "replaced", "aborted")  # phases after which nothing more is reported

Named = tuple[str, str | None]  # code, joint


@dataclass(frozen=True, slots=True)
class CommandOutcome:
    """Result of one command."""

    method: str
    error: str | None = None  # of the interface, without its prefix
    findings: tuple[Named, ...] = ()  # why: codes in their order, with their joints
    phase: str | None = None  # of a trajectory, the last reported one
    answered: bool = True

    def words(self) -> str:
        """For people."""
        if not self.answered:
            return f"{self.method}: not answered"
        said = self.error or self.phase or "done"
        found = ", ".join(code if joint is None else f"{code} {joint}" for code, joint in self.findings)
        return f"{self.method}: {said}" + (f" ({found})" if found else "")


@dataclass(frozen=True, slots=True)
class RunOutcome:
    """Result of a recording or of its replay; two of them are compared."""

    answers: tuple[CommandOutcome, ...]
    faults: Mapping[Named, float]  # that stayed until they were acknowledged, or to the end -> s since begin
    state: str  # at the end
    mode: str
    armed: bool

    def plain(self) -> dict[str, object]:
        """Convert to a dict that JSON can represent."""
        return {
            "answers": [
                {
                    "method": each.method,
                    "answered": each.answered,
                    "error": each.error,
                    "phase": each.phase,
                    "findings": [{"code": code, "joint": joint} for code, joint in each.findings],
                }
                for each in self.answers
            ],
            "faults": [
                {"code": code, "joint": joint, "time": round(time, 3)}
                for (code, joint), time in sorted(self.faults.items(), key=lambda each: each[1])
            ],
            "state": self.state,
            "mode": self.mode,
            "armed": self.armed,
        }


def answer(method: str, replies: Sequence[Mapping[str, Any]], error: str | None = None) -> CommandOutcome:
    """Build the outcome of one call from the parameters of all its replies, with joints named.

    `error`: the error of the last reply.
    """
    if not replies:
        return CommandOutcome(method, answered=False)
    last = replies[-1]
    phases = [each["phase"] for each in replies if each.get("phase")]
    found = [*(last.get("findings") or ()), *((last.get("verdict") or {}).get("refusals") or ())]
    named = tuple((str(each["code"]), each["joint"]) for each in found)
    return CommandOutcome(method, error, named, phases[-1] if phases else None)


@dataclass
class UnclearedFaults:
    """Faults that stay: of those reported while a state is latched, the ones present when that state ends."""

    _since: dict[Named, float] = field(default_factory=dict)  # of all that are reported now
    _last: dict[Named, float] = field(default_factory=dict)  # of those, in a latched state
    _kept: dict[Named, float] = field(default_factory=dict)
    _before: bool = False

    def look(self, time: float, state: str, faults: Sequence[Named]) -> None:
        """Update with the state and the faults that are reported at `time` (s)."""
        self._since = {each: self._since.get(each, time) for each in faults}
        if state in RESET_STATES:
            self._last = dict(self._since)
        elif self._before:
            self._keep()
        self._before = state in RESET_STATES

    def end(self) -> dict[Named, float]:
        """Return all faults that stayed, with the time since which each was reported, s."""
        if self._before:
            self._keep()
        return dict(self._kept)

    def _keep(self) -> None:
        self._kept = {**self._last, **self._kept}
        self._last = {}


def differences(recorded: RunOutcome, replayed: RunOutcome, tolerance: float) -> Iterator[str]:
    """Yield the differences of two outcomes, in words; times may differ by `tolerance` (s)."""
    if len(recorded.answers) != len(replayed.answers):
        yield f"recorded {len(recorded.answers)} commands, replayed {len(replayed.answers)}"
    pairs = zip(recorded.answers, replayed.answers, strict=False)
    for number, (then, now) in enumerate(pairs, 1):
        if not _same(then, now):
            yield f"command {number}: recorded {then.words()}; replayed {now.words()}"
    for named, time in recorded.faults.items():
        what = " ".join(filter(None, named))
        if named not in replayed.faults:
            yield f"fault {what} after {time:.2f} s did not come"
        elif abs(late := replayed.faults[named] - time) > tolerance:
            yield f"fault {what}: recorded after {time:.2f} s, replayed {late:+.2f} s from that"
    for named, time in replayed.faults.items():
        if named not in recorded.faults:
            yield f"fault {' '.join(filter(None, named))} after {time:.2f} s was not recorded"
    for what in ("state", "mode", "armed"):
        then = getattr(recorded, what)
        now = getattr(replayed, what)
        if then != now:
            yield f"{what} at the end: recorded {then}, replayed {now}"


def uncompared(recorded: RunOutcome, replayed: RunOutcome) -> Iterator[str]:
    """Yield, in words, the commands whose end the recording does not contain, and their replayed result."""
    pairs = zip(recorded.answers, replayed.answers, strict=False)
    for number, (then, now) in enumerate(pairs, 1):
        if not then.answered:
            yield f"command {number}: the recording has no answer; replayed {now.words()}"
        elif _open(then) and then.phase != now.phase:
            yield f"command {number}: recorded until {then.phase}; replayed {now.words()}"


def _open(then: CommandOutcome) -> bool:
    """Check that a command went on after the end of the recording."""
    return then.error is None and then.phase is not None and then.phase not in ENDED


def _same(then: CommandOutcome, now: CommandOutcome) -> bool:
    """Compare two outcomes of a command; one whose end is not recorded is compared as far as the recording
    goes."""
    if not then.answered:
        return True
    if (then.error, then.findings) != (now.error, now.findings) or not now.answered:
        return False
    return then.phase not in ENDED or then.phase == now.phase
