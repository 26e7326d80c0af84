"""Trend of the gap against the reference of the identified model: a worn gear, a loose horn, a load. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass

from twind.config.identified_spec import IdentifiedModel
from twind.gap.gap_figures import JointGap

GROWN = 1.5  # times the reference: a joint is reported
CALM = 1.2  # times the reference: below it a joint may be reported again
IN_A_ROW = 3  # figures above the bound, so that one second does not report


@dataclass(frozen=True, slots=True)
class GrownGap:
    """A joint whose unexplained share of the position exceeds its bound."""

    joint: str
    value: float
    bound: float


class GapTrend:
    """Reports each joint once while its gap is grown."""

    def __init__(self, identified: IdentifiedModel | None) -> None:
        joints = {} if identified is None else identified.joints
        self._reference = {name: each.gap.unexplained for name, each in joints.items() if each.gap}
        self._above: dict[str, int] = {}

    def update(self, gaps: Sequence[JointGap]) -> list[GrownGap]:
        """Take the figures of a window; return the joints that are newly grown."""
        found: list[GrownGap] = []
        for gap in gaps:
            reference = self._reference.get(gap.joint)
            value = None if gap.position is None else gap.position.unexplained
            if not reference or value is None:
                continue
            above = self._above.get(gap.joint, 0)
            if value > GROWN * reference:
                self._above[gap.joint] = above + 1
                if above + 1 == IN_A_ROW:
                    found.append(GrownGap(gap.joint, value, GROWN * reference))
            elif value < CALM * reference or above < IN_A_ROW:
                self._above[gap.joint] = 0
        return found
