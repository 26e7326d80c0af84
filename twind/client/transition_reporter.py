"""What is wrong, said when it begins and when it is over, not at every try. Standard library only."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class TransitionReporter:
    """Says what is wrong when it begins and when it is over, not at every try. `every`: s between two."""

    every: float = 10.0
    wrong: str = ""
    told: str = ""
    at: float = float("-inf")

    def news(self, wrong: str, now: float) -> bool:
        """`wrong` ("": nothing) is worth a line now. Reasons that come by turns get one each `every` s."""
        self.wrong = wrong
        if wrong == self.told or (wrong and self.told and now - self.at < self.every):
            return False
        self.told, self.at = wrong, now
        return True
