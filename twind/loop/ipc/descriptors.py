"""Number of descriptors that a daemon needs, and the limit of its process (setrlimit(2)).

Used at start only.
"""

import resource

from twind.exceptions import InvalidInput
from twind.loop.ipc.child_process import ABOVE
from twind.loop.ipc.front_process import HANDED

_STANDING = (
    18  # standard streams, notifier, sockets, briefing, flight recorders, link, power process, virtual robot
)
_PASSING = 8  # open for a short time: a front that is started, files
_OF_A_BUS = 2


def needed(buses: int, front: int) -> int:
    """Return the descriptors that loop and front need each.

    `front`: the need of the front, which inherits the limit.
    """
    loop = max(ABOVE, _STANDING + _OF_A_BUS * buses + _PASSING) + HANDED
    return max(loop, front)


def ensure(count: int) -> str:
    """Allow `count` descriptors; return a text on the change, "" without one. Raises OperationFailed."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if _enough(soft, count):
        return ""
    if not _enough(hard, count):
        remedy = f"`ulimit -n {count}`, LimitNOFILE={count} in the unit, or `nofile` in limits.conf(5)"
        reason = f"{count} are needed, and the hard limit is {hard}; raise it as root: {remedy}"
        raise InvalidInput(reason, where="open files")
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    return f"open files: the soft limit was {soft}, below the {count} needed; raised to the hard limit {hard}"


def _enough(limit: int, count: int) -> bool:
    return limit == resource.RLIM_INFINITY or limit >= count
