"""Travel of each actuator as it was measured, from which its turn is determined. Pure data."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twind.robot.arrays import Bools, Ints

ROOM = 4  # part of a turn that a joint with a long travel may stand beyond it, at most


@dataclass(frozen=True)
class MeasuredTravel:
    """Arrays (n,) in `JointMap` order, in calibrated counts; they are valid where `known` is True.

    A count read is off by whole turns; the one that lies in its band is the calibrated count.
    """

    known: Bools  # it has a measured travel
    whole: Ints  # ticks of a turn
    band: Ints  # begin of the turn that holds the travel in its middle
    first: Ints  # the travel's ends
    last: Ints
    slack: Ints  # ticks that a limp joint may hang beyond them
    least: Ints  # range of its goal register
    most: Ints
    lower: Ints  # range of the goals that may ever be sent (WIRE_CLAMP)
    upper: Ints
    # At torque-on it counts anew, in one turn: Dynamixel in position mode (e-manual, "Operating Mode", note).
    falls: Bools
    begin: Ints  # the first count of that turn, its homing offset included

    @cached_property
    def ambiguous(self) -> Bools:
        """Joints (n,) with places where more than one turn fits the travel and its slack."""
        marked: Bools = self.known & (self.last - self.first + 2 * self.slack >= self.whole)
        return marked

    @cached_property
    def long(self) -> Bools:
        """Joints (n,) with a travel of a turn or more."""
        marked: Bools = self.known & (self.last - self.first >= self.whole)
        return marked

    @cached_property
    def room(self) -> Ints:
        """Ticks (n,) beyond the travel in which a joint may stand while its turn is chosen.

        Of a long travel another turn lies inside: a sweep that missed a stop must not hide that.
        """
        wide: Ints = np.where(self.long, np.maximum(self.slack, self.whole // ROOM), self.slack)
        return wide
