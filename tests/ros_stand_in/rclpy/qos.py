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
    def __init__(self, **kwargs):
        if (
            kwargs.get("history", HistoryPolicy.KEEP_LAST) == HistoryPolicy.KEEP_LAST
            and "depth" not in kwargs
        ):
            raise ValueError("History set to KEEP_LAST without a depth setting.")
        self.depth = kwargs.pop("depth", 0)
        self.history = kwargs.pop("history", HistoryPolicy.KEEP_LAST)
        self.reliability = kwargs.pop("reliability", ReliabilityPolicy.RELIABLE)
        self.durability = kwargs.pop("durability", DurabilityPolicy.VOLATILE)
        if kwargs:
            raise TypeError(f"no such policies: {sorted(kwargs)}")


def profile(given):
    """Of a profile, or of a depth alone."""
    return given if isinstance(given, QoSProfile) else QoSProfile(depth=given)


def matches(writer, reader):
    """Both are endpoints as others read them. A reader never has more than its writer offers."""
    return writer["reliability"] <= reader["reliability"] and writer["durability"] <= reader["durability"]
