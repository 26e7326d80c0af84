"""All wrong daemons of a CAN bus."""

from tests.proof.evil import can_ends, can_goals
from tests.proof.evil.can_good import EVILS

__all__ = ["EVILS", "can_ends", "can_goals"]
