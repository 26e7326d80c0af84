"""Mapping of a leader's readings to a follower's goals, and when a reading may be used. Reads no clock."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite

from twind.exceptions import InvalidInput

STALE = 0.1  # s; the age from which the gate takes a joint for lost


@dataclass(frozen=True, slots=True)
class JointLink:
    """A joint of the follower and the joint of the leader that it follows."""

    leader: str
    follower: str
    scale: float = 1.0  # negative mirrors
    offset: float = 0.0  # rad

    def goal(self, position: float) -> float:
        """Return the follower's goal (rad) for a position (rad) of the leader."""
        return self.scale * position + self.offset


def link_joints(
    leader: Sequence[str],
    follower: Sequence[str],
    renamed: Mapping[str, str],
    scales: Mapping[str, float],
    offsets: Mapping[str, float],
) -> tuple[JointLink, ...]:
    """Return the links in the follower's order: joints of one name, and those `renamed` (leader: follower).

    `scales` and `offsets` (rad) are by joint of the follower. Raises InvalidInput: an unknown joint, two
    leaders of one joint, a number that is not finite, or no link.
    """
    _check_names("leader", renamed, leader)
    _check_names("follower", renamed.values(), follower)
    source = {name: name for name in leader if name in follower and name not in renamed}
    for name in source:
        if name in renamed.values():
            source[name] = ""
    for old, new in renamed.items():
        if source.get(new):
            raise InvalidInput(f"{new} has two leaders, {source[new]} and {old}: map it once")
        source[new] = old
    links = tuple(
        JointLink(source[name], name, scales.get(name, 1.0), offsets.get(name, 0.0))
        for name in follower
        if source.get(name)
    )
    if not links:
        raise InvalidInput("leader and follower share no joint: map one with --map LEADER=FOLLOWER")
    linked = [each.follower for each in links]
    for values in (scales, offsets):
        _check_names("follower", values, linked)
        for name, value in values.items():
            if not isfinite(value):
                raise InvalidInput(f"{name}: {value} is not a finite number")
    return links


def stale_reading(
    links: Sequence[JointLink], past: float, positions: Mapping[str, float], ages: Mapping[str, float]
) -> str | None:
    """Return a text on what forbids goals from a reading; None: it may be used.

    `past`: s since the leader's state was sent; `ages`: s of each joint at that time.
    """
    if not 0.0 <= past <= STALE:
        return f"the leader's state is {past * 1e3:.0f} ms old, bound {STALE * 1e3:.0f} ms"
    for each in links:
        age = past + ages.get(each.leader, float("nan"))
        if not past <= age <= STALE:  # an age below 0 is no reading
            return f"the leader's {each.leader} was read {age * 1e3:.0f} ms ago, bound {STALE * 1e3:.0f} ms"
        if not isfinite(positions.get(each.leader, float("nan"))):
            return f"the leader's {each.leader} gave no position"
    return None


def _check_names(side: str, names: Iterable[str], known: Sequence[str]) -> None:
    for name in names:
        if name not in known:
            raise InvalidInput(f"{name} is not a linked joint of the {side}; known: {', '.join(known)}")
