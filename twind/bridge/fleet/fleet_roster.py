"""Who is known, what each said last, and how long ago that was. Pure: `now` is given, monotonic seconds.

Whoever was known stays: one that is gone is lost, not forgotten.
"""

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import msgspec

MOST = 10_000  # robots that are kept
UPLINK = "uplink"  # where a robot is that is reached over Zenoh; others: the folder of their sockets


@dataclass(frozen=True, slots=True)
class RobotRecord:
    """One robot as it is known. What was never told is None."""

    name: str
    where: str = ""  # UPLINK, or the folder of its sockets; empty: nowhere yet
    status: Mapping[str, Any] | None = None  # of GetStatus, what a list shows
    heard: int | None = None  # joints that answer
    joints: int | None = None
    told_at: float | None = None  # s, monotonic, when it said all this
    way: float | None = None  # s, from the question to its answer
    lost: str = ""  # why it says nothing any more; empty: it is there
    odd: str = ""  # why what it says now cannot be understood; empty: it can

    def age(self, now: float) -> float | None:
        """s since it said anything."""
        return None if self.told_at is None else now - self.told_at


Word = Annotated[str, msgspec.Meta(max_length=40)]
Milliseconds = Annotated[float, msgspec.Meta(ge=-1e9, le=1e9)]  # no NaN either


class _Fault(msgspec.Struct):
    code: Word


class _Status(msgspec.Struct):
    mode: Word
    state: Word
    motion: Word
    armed: bool
    faults: list[_Fault]
    latency_ms: Milliseconds | None


class _JointReport(msgspec.Struct):
    heard: bool


class _StatusReply(msgspec.Struct):
    """What a list shows of GetStatus with joints. Fields more, of a newer robot, are none of ours."""

    status: _Status
    joints: list[_JointReport]


class FleetRoster:
    """All of them. Filled by several threads, looked at by another."""

    def __init__(self, wanted: Sequence[str] = ()) -> None:
        """`wanted`: robots that are lost until they are there; empty: whoever is there."""
        self._lock = threading.Lock()
        self._wanted = tuple(wanted)
        self._robots: dict[tuple[str, str], RobotRecord] = {}

    def there(self, name: str, where: str) -> bool:
        """It can be reached; what it says is not known yet. False: it is left out, as MOST are known."""
        return self._keep(name, where, lost="")

    def told(self, name: str, where: str, answer: object, now: float, way: float) -> None:
        """An answer of GetStatus with joints; where it is none, that is what is known of it."""
        try:
            said = msgspec.convert(answer, _StatusReply)
        except msgspec.ValidationError as error:
            self.odd(name, where, str(error))
            return
        status, heard = msgspec.to_builtins(said.status), sum(joint.heard for joint in said.joints)
        joints = len(said.joints)
        self._keep(
            name, where, status=status, heard=heard, joints=joints, told_at=now, way=way, lost="", odd=""
        )

    def odd(self, name: str, where: str, why: str) -> None:
        """It answers, and nobody understands what. What it said last stays, and gets old."""
        self._keep(name, where, odd=why)

    def lost(self, name: str, where: str, why: str) -> None:
        """It says nothing any more. What it said last stays."""
        self._keep(name, where, lost=why)

    def robots(self) -> list[RobotRecord]:
        """Those that are wanted, by name, that of this machine first; one that was never there is lost."""
        with self._lock:
            found = [each for each in self._robots.values() if not self._wanted or each.name in self._wanted]
        missing = set(self._wanted) - {each.name for each in found}
        found += [RobotRecord(name, lost="nobody of this name is there") for name in missing]
        return sorted(found, key=lambda each: (each.name, each.where == UPLINK, each.where))

    def waiting(self) -> bool:
        """Somebody is there of whom nothing is known yet."""
        return any(each.told_at is None and not (each.lost or each.odd) for each in self.robots())

    def _keep(self, name: str, where: str, **known: Any) -> bool:
        """What is known of it now, beside what was. False: it is left out."""
        with self._lock:
            before = self._robots.get((name, where))
            if before is None and len(self._robots) >= MOST:
                return False
            self._robots[name, where] = replace(before or RobotRecord(name, where), **known)
            return True
