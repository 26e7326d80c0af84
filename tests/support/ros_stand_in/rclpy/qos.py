"""Qualities of topics, and which writer a reader matches."""

from enum import IntEnum


class ReliabilityPolicy(IntEnum):
    RELIABLE = 1
    BEST_EFFORT = 2


class DurabilityPolicy(IntEnum):
    TRANSIENT_LOCAL = 1
    VOLATILE = 2


class HistoryPolicy(IntEnum):
    KEEP_LAST = 1
    KEEP_ALL = 2


class QoSProfile:
    def __init__(
        self,
        history=HistoryPolicy.KEEP_LAST,
        depth=None,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.VOLATILE,
    ):
        if history == HistoryPolicy.KEEP_LAST and depth is None:
            raise ValueError("History set to KEEP_LAST without a depth setting.")
        self.history = history
        self.depth = depth or 0
        self.reliability = reliability
        self.durability = durability


def profile(given):
    """Profile from a profile, or from a depth alone."""
    return given if isinstance(given, QoSProfile) else QoSProfile(depth=given)


def matches(writer, reader):
    """Both are endpoints as others read them. A reader never has more than its writer offers."""
    return writer["reliability"] <= reader["reliability"] and writer["durability"] <= reader["durability"]
