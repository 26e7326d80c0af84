"""Trend of the gap against the reference of the identified model: a worn gear, a loose horn, a load. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass

from twind.config.identified_spec import IdentifiedModel
from twind.gap.gap_figures import GapFigure, JointGap

GROWN = 1.5  # times the reference: a joint is reported
CALM = 1.2  # times the reference: below it a joint may be reported again
IN_A_ROW = 3  # figures above the bound, so that one second does not report


@dataclass(frozen=True, slots=True)
class GrownGap:
    """A joint whose unexplained share of `quantity` exceeds its bound."""

    joint: str
    quantity: str  # position or effort
    value: float
    bound: float


class GapTrend:
    """Reports each joint once while its gap is grown, in position or effort: a load shows in effort first."""

    def __init__(self, identified: IdentifiedModel | None) -> None:
        joints = {} if identified is None else identified.joints
        known = {name: each.gap for name, each in joints.items() if each.gap}
        self._references = {
            name: (("position", gap.unexplained, 0.0), ("effort", gap.effort, gap.effort_nm or 0.0))
            for name, gap in known.items()
        }
        self._above: dict[tuple[str, str], int] = {}
        self._reported: dict[str, str] = {}  # joint -> the quantity reported, until it is calm

    def update(self, gaps: Sequence[JointGap]) -> list[GrownGap]:
        """Take the figures of a window; return the joints that are newly grown."""
        return [grown for gap in gaps if (grown := self._newly_grown(gap)) is not None]

    def _newly_grown(self, gap: JointGap) -> GrownGap | None:
        grown: list[GrownGap] = []
        for quantity, reference, rms in self._references.get(gap.joint, ()):
            figure: GapFigure | None = getattr(gap, quantity)
            value = None if figure is None else figure.unexplained
            if figure is None or not reference or value is None:
                continue
            above = self._above.get((gap.joint, quantity), 0)
            if value > GROWN * reference and figure.rms >= GROWN * rms:  # a share of little effort is large
                self._above[gap.joint, quantity] = above + 1
                if above + 1 >= IN_A_ROW:
                    grown.append(GrownGap(gap.joint, quantity, value, GROWN * reference))
            elif value < CALM * reference or above < IN_A_ROW:
                self._above[gap.joint, quantity] = 0
                if self._reported.get(gap.joint) == quantity:
                    del self._reported[gap.joint]  # another quantity may have grown meanwhile
        if not grown or gap.joint in self._reported:
            return None
        self._reported[gap.joint] = grown[0].quantity
        return grown[0]
