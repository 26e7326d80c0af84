"""Reporter of a fault at its beginning and at its end, not at every retry. Standard library only."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class RepeatedFaultFilter:
    """Reports a fault when it begins and when it is over, not at every retry. `every`: s between two."""

    every: float = 10.0
    wrong: str = ""
    told: str = ""
    at: float = float("-inf")

    def is_transition(self, wrong: str, now: float) -> bool:
        """True if `wrong` ("": no fault) needs a line now. Alternating reasons get one each `every` s."""
        self.wrong = wrong
        if wrong == self.told or (wrong and self.told and now - self.at < self.every):
            return False
        self.told = wrong
        self.at = now
        return True
