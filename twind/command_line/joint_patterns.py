"""Joints by patterns, as options name them: `left_*,head_yaw`. Standard library only."""

from collections.abc import Sequence
from fnmatch import fnmatchcase

from twind.command_line.verb import UsageError


def matching_joints(names: Sequence[str], patterns: str, option: str) -> list[str]:
    """Return the `names` that match comma-separated `patterns`, in their order.

    Raises UsageError, which names `option`, for a pattern that matches none.
    """
    asked = patterns.split(",")
    for pattern in asked:
        if not any(fnmatchcase(name, pattern) for name in names):
            raise UsageError(f"{option}: no joint {pattern!r}; there are {', '.join(names)}")
    return [name for name in names if any(fnmatchcase(name, pattern) for pattern in asked)]
