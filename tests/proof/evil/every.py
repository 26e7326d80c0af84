"""All wrong daemons."""

from tests.proof.evil import ends, goals, packets, search
from tests.proof.evil.good import EVILS

__all__ = ["EVILS", "ends", "goals", "packets", "search"]
