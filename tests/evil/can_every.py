"""All wrong daemons of a CAN bus."""

from evil import can_ends, can_goals
from evil.can_registry import EVILS

__all__ = ["EVILS", "can_ends", "can_goals"]
