"""Search for gains: from the best gains so far one bounded change at a time. Pure.

A try is fit if it neither overshoots beyond the bound nor rings. Among fit ones the integral of the absolute
error decides (IAE): it counts lag, swings and remaining error alike. I is only ever lowered.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from twind.exceptions import InvalidInput
from twind.tuning.step_response import BAND, StepResponse

Gains = Mapping[str, float]

FACTOR = 1.4  # of the stiffness, at most per try
MOST = 4.0  # times the gains at the start, either way
BETTER = 0.97  # times the best IAE: less of a difference is chance
# Stiffness and damping of a family, and the change of damping per stiffness that one try may make at least.
# Dynamixel: D/16 acts each millisecond and P/128 on the error, so D = P/2 is 4 ms; CAN: kd/kp is a time in s.
FAMILIES = (("p", "d", 0.5), ("kp", "kd", 0.005))


@dataclass(frozen=True, slots=True)
class GainTry:
    """Gains that were tried. `response` None: `stopped` gives the reason."""

    gains: Gains
    response: StepResponse | None
    stopped: str = ""


@dataclass(slots=True)
class GainSearch:
    """Tries so far, and the next gains. `limits`: the largest value of each gain."""

    start: Gains
    limits: Gains
    overshoot: float  # share of the step, at most
    tries: list[GainTry] = field(default_factory=list)
    _moves: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Raises InvalidInput: these gains are not of a position loop that can be tuned."""
        named = [each for each in FAMILIES if set(each[:2]) <= set(self.start)]
        if not named or not self.start[named[0][0]] > 0.0:
            raise InvalidInput(
                f"gains {', '.join(self.start)}: only P and D, or kp and kd, above 0 can be tuned"
            )

    @property
    def best(self) -> GainTry | None:
        """The best try; None: none was completed."""
        done = [each for each in self.tries if each.response is not None]
        found = done[0] if done else None
        for each in done[1:]:
            if found is not None and self._improves(each, found):
                found = each
        return found

    def next(self) -> Gains | None:
        """Return gains that are not tried yet; None: no change of the best ones is left."""
        if not self.tries:
            return self.start
        best = self.best
        if best is None:
            return None
        moves = ["stiffer", "damped", "freer"] if self.is_fit(best) else ["leaner", "damped", "softer"]
        if best is self.tries[-1] and self._moves:  # that direction helps: first on in it
            moves.sort(key=lambda move: move != self._moves[-1])
        for move in moves:
            wanted = self._moved(best.gains, move)
            if wanted not in [each.gains for each in self.tries]:
                self._moves.append(move)
                return wanted
        return None

    def is_fit(self, tried: GainTry) -> bool:
        """Return True for a try within the bounds."""
        response = tried.response
        return response is not None and response.overshoot <= self.overshoot and not response.rings

    def _improves(self, new: GainTry, old: GainTry) -> bool:
        assert new.response is not None
        assert old.response is not None
        if self.is_fit(new) != self.is_fit(old):
            return self.is_fit(new)
        if not self.is_fit(new):
            return _excess(new.response) < BETTER * _excess(old.response)
        return new.response.iae < BETTER * old.response.iae

    def _moved(self, gains: Gains, move: str) -> dict[str, float]:
        stiffness, damping, first = next(each for each in FAMILIES if set(each[:2]) <= set(gains))
        change = max((FACTOR - 1.0) * gains[damping], first * gains[stiffness])
        wanted = {
            "stiffer": {stiffness: gains[stiffness] * FACTOR},
            "softer": {stiffness: gains[stiffness] / FACTOR},
            "leaner": {"i": gains["i"] / 2.0} if gains.get("i") else {},
            "damped": {damping: gains[damping] + change},
            "freer": {damping: gains[damping] - change},
        }[move]
        return dict(gains) | {name: self._bounded(name, value) for name, value in wanted.items()}

    def _bounded(self, name: str, value: float) -> float:
        """Return a gain within limits and the reach of this tuning, in whole counts where it is in counts."""
        base = self.start[name]
        if name in ("p", "kp"):
            value = min(max(value, base / MOST), base * MOST)
        value = min(max(value, 0.0), self.limits.get(name, value))
        return float(round(value)) if name in ("p", "i", "d") else round(value, 3)


def _excess(response: StepResponse) -> float:
    """Return how far a try is from fit: overshoot, and each swing as much as its least size."""
    return response.overshoot + BAND * response.swings
