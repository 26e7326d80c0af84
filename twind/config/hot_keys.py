"""Keys that change at any time; whatever else changes is the robot's. Imports nothing heavy."""

from collections.abc import Mapping
from typing import Any

LEVEL = "log_level"
WARN = "thresholds.latency_warn_ms"
BLOCK = "thresholds.latency_block_ms"
OF_SETTINGS = frozenset({LEVEL, WARN, BLOCK})
GAINS = ("types.", ".gains")  # how the keys of gains begin and end
PROOF = "calibration.proof"  # what was shown of it since: nothing is judged by it


def is_gains(key: str) -> bool:
    """True for a key `types.TYPE.gains`."""
    return key.startswith(GAINS[0]) and key.endswith(GAINS[1])


def of_robot(changes: Mapping[str, Any]) -> dict[str, Any]:
    """The changes that concern the robot: made only while it is at rest."""
    return {key: value for key, value in changes.items() if key not in OF_SETTINGS and key != PROOF}
