"""Normal distribution of a measured value, cut at 2.5 standard deviations and at physical bounds."""

from dataclasses import dataclass
from statistics import NormalDist

CUT = 2.5  # standard deviations: 1.2 % of the draws lie beyond
Entry = int | str  # joint or axis by number, body by name
_NORMAL = NormalDist()


@dataclass(frozen=True, slots=True)
class MeasuredSpread:
    """A normal distribution of mean `centre` between `low` and `high`; the shares are theirs."""

    centre: float
    sd: float
    low: float
    high: float
    low_share: float
    high_share: float

    def at(self, share: float) -> float:
        """Return the value below which `share` (0 to 1) of the draws lie."""
        if self.sd <= 0.0:
            return self.centre
        within = self.low_share + share * (self.high_share - self.low_share)
        value = self.centre + self.sd * _NORMAL.inv_cdf(within)
        return min(max(value, self.low), self.high)


def spread_within(centre: float, sd: float, least: float, most: float) -> MeasuredSpread:
    """Return the spread of a value between the bounds `least` and `most`, itself moved between them."""
    centre = min(max(centre, least), most)
    low = max(centre - CUT * sd, least)
    high = min(centre + CUT * sd, most)
    if sd <= 0.0:
        return MeasuredSpread(centre, 0.0, centre, centre, 0.0, 1.0)
    shares = [_NORMAL.cdf((end - centre) / sd) for end in (low, high)]
    return MeasuredSpread(centre, sd, low, high, shares[0], shares[1])
