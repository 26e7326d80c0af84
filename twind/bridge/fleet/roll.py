"""Who is known, what each said last, and how long ago that was. Pure: `now` is given, monotonic seconds.

Whoever was known stays: one that is gone is lost, not forgotten.
"""

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

UPLINK = "uplink"  # where a robot is that is reached over Zenoh; others: the folder of their sockets


@dataclass(frozen=True, slots=True)
class Robot:
    """One robot as it is known. What was never told is None."""

    name: str
    where: str = ""  # UPLINK, or the folder of its sockets; empty: nowhere yet
    status: Mapping[str, Any] | None = None  # of GetStatus
    heard: int | None = None  # joints that answer
    joints: int | None = None
    told_at: float | None = None  # s, monotonic, when it said all this
    way: float | None = None  # s, from the question to its answer
    lost: str = ""  # why it says nothing any more; empty: it is there

    def age(self, now: float) -> float | None:
        """s since it said anything."""
        return None if self.told_at is None else now - self.told_at


class Roll:
    """All of them. Filled by several threads, looked at by another."""

    def __init__(self, wanted: Sequence[str] = ()) -> None:
        """`wanted`: robots that are lost until they are there; empty: whoever is there."""
        self._lock = threading.Lock()
        self._wanted = tuple(wanted)
        self._robots: dict[tuple[str, str], Robot] = {}

    def there(self, name: str, where: str) -> None:
        """It can be reached; what it says is not known yet."""
        with self._lock:
            self._robots[name, where] = replace(self._known(name, where), lost="")

    def told(self, name: str, where: str, answer: Mapping[str, Any], now: float, way: float) -> None:
        """An answer of GetStatus with joints. Raises KeyError, TypeError where it is none."""
        status, joints = answer["status"], answer["joints"]
        heard = sum(bool(joint["heard"]) for joint in joints)
        with self._lock:
            self._robots[name, where] = Robot(name, where, status, heard, len(joints), now, way)

    def lost(self, name: str, where: str, why: str) -> None:
        """It says nothing any more. What it said last stays."""
        with self._lock:
            self._robots[name, where] = replace(self._known(name, where), lost=why)

    def robots(self) -> list[Robot]:
        """Those that are wanted, by name, that of this machine first; one that was never there is lost."""
        with self._lock:
            found = [each for each in self._robots.values() if not self._wanted or each.name in self._wanted]
        missing = set(self._wanted) - {each.name for each in found}
        found += [Robot(name, lost="nobody of this name is there") for name in missing]
        return sorted(found, key=lambda each: (each.name, each.where == UPLINK, each.where))

    def waiting(self) -> bool:
        """Somebody is there of whom nothing is known yet."""
        return any(not each.lost and each.told_at is None for each in self.robots())

    def _known(self, name: str, where: str) -> Robot:
        return self._robots.get((name, where)) or Robot(name, where)
