"""Known robots, the last status of each, and its age. Pure: `now` is given, monotonic seconds.

A robot once known stays in the roster: when it is gone it is marked as lost, not removed.
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
    """State of one robot as last reported. A value never received is None."""

    name: str
    where: str = ""  # UPLINK, or the folder of its sockets; empty: nowhere yet
    status: Mapping[str, Any] | None = None  # of GetStatus, what a list shows
    answering: int | None = None  # joints that answer
    joints: int | None = None
    reported_at: float | None = None  # s, monotonic, time of this report
    way: float | None = None  # s, from the question to its answer
    lost: str = ""  # why it reports no longer; empty: it is present
    odd: str = ""  # why its report cannot be decoded; empty: it can

    def age(self, now: float) -> float | None:
        """Return the s since its last status; None: none was received."""
        return None if self.reported_at is None else now - self.reported_at


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
    """The fields of GetStatus with joints that a list shows. Other fields, of a newer robot, are ignored."""

    status: _Status
    joints: list[_JointReport]


class FleetRoster:
    """Roster of all robots. Filled by several threads, read by another."""

    def __init__(self, wanted: Sequence[str] = ()) -> None:
        """Make the roster; `wanted`: robots that are lost until they appear; empty: every robot present."""
        self._lock = threading.Lock()
        self._wanted = tuple(wanted)
        self._robots: dict[tuple[str, str], RobotRecord] = {}

    def there(self, name: str, where: str) -> bool:
        """Record that the robot can be reached; its status is not known yet.

        False: it is left out, as MOST are known.
        """
        return self._keep(name, where, lost="")

    def update_status(self, name: str, where: str, answer: object, now: float, way: float) -> None:
        """Record an answer of GetStatus with joints; an answer of another form is recorded as `odd`."""
        try:
            report = msgspec.convert(answer, _StatusReply)
        except msgspec.ValidationError as error:
            self.odd(name, where, str(error))
            return
        status = msgspec.to_builtins(report.status)
        answering = sum(joint.heard for joint in report.joints)
        joints = len(report.joints)
        self._keep(
            name,
            where,
            status=status,
            answering=answering,
            joints=joints,
            reported_at=now,
            way=way,
            lost="",
            odd="",
        )

    def odd(self, name: str, where: str, why: str) -> None:
        """Record an answer that cannot be decoded. The last status stays, and ages."""
        self._keep(name, where, odd=why)

    def mark_lost(self, name: str, where: str, why: str) -> None:
        """Record that the robot no longer answers. The last status stays."""
        self._keep(name, where, lost=why)

    def robots(self) -> list[RobotRecord]:
        """Return the wanted robots by name, that of this machine first; one that was never there is lost."""
        with self._lock:
            found = [each for each in self._robots.values() if not self._wanted or each.name in self._wanted]
        missing = set(self._wanted) - {each.name for each in found}
        found += [RobotRecord(name, lost="no robot of this name is present") for name in missing]
        return sorted(found, key=lambda each: (each.name, each.where == UPLINK, each.where))

    def has_unknown_robots(self) -> bool:
        """Return True if a robot is there of which no status is known yet."""
        return any(each.reported_at is None and not (each.lost or each.odd) for each in self.robots())

    def _keep(self, name: str, where: str, **known: Any) -> bool:
        """Update the record of a robot with `known`, keeping its other fields. False: it is left out."""
        with self._lock:
            before = self._robots.get((name, where))
            if before is None and len(self._robots) >= MOST:
                return False
            self._robots[name, where] = replace(before or RobotRecord(name, where), **known)
            return True
