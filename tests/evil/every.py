"""All wrong daemons."""

from evil import ends, goals, packets, search
from evil.registry import EVILS

__all__ = ["EVILS", "ends", "goals", "packets", "search"]
