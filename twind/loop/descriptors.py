"""Number of descriptors that a daemon needs, and the limit of its process (setrlimit(2)).

Used at start only.
"""

import resource

from twind.loop.front_process import ABOVE, HANDED

_STANDING = (
    16  # standard streams, notifier, sockets, briefing, flight recorders, link, a virtual robot's pipes
)
_PASSING = 8  # open for a short time: a front that is started, files
_OF_A_BUS = 2


class TooFewDescriptors(Exception):
    """Exception: the limit of open descriptors is below the need and may not be raised so far."""

    def __init__(self, limit: int, needed: int) -> None:
        remedy = f"`ulimit -n {needed}`, LimitNOFILE={needed} in the unit, or `nofile` in limits.conf(5)"
        super().__init__(
            f"open files: {needed} are needed, and the hard limit is {limit}; raise it as root: {remedy}"
        )


def needed(buses: int, front: int) -> int:
    """Return the descriptors that loop and front need each.

    `front`: the need of the front, which inherits the limit.
    """
    loop = max(ABOVE, _STANDING + _OF_A_BUS * buses + _PASSING) + HANDED
    return max(loop, front)


def ensure(count: int) -> str:
    """Allow `count` descriptors; return a text on the change, "" without one. Raises TooFewDescriptors."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if _enough(soft, count):
        return ""
    if not _enough(hard, count):
        raise TooFewDescriptors(hard, count)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    return f"open files: the soft limit was {soft}, below the {count} needed; raised to the hard limit {hard}"


def _enough(limit: int, count: int) -> bool:
    return limit == resource.RLIM_INFINITY or limit >= count
