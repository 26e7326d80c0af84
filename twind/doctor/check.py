"""Types of the doctor: rows of its table, findings and fixes. Pure: inspects nothing and prints nothing.

A `Check` is a row of the table, as the troubleshooting page shows it. A `DoctorFinding` is that defect on
this machine: the thing, what was measured, what should be, and what mends it.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

from twind.exceptions import TwindError

MANY = 3  # devices of one bus with the same finding; more of them share one finding

# Cautions that several rows share: what to make sure of before a remedy is followed.
SUPPORT = "support the robot: it is lowered or goes limp"
FIRMWARE = (
    "support the robot without torque; an update can reset registers: "
    "note id, rate, homing offset, limits; calibrate afterwards"
)
UNPLUGGED = (
    "support the robot, disarm, switch the supply off before plugging: "
    "a silent device may still hold its joint"
)
OTHER_MASTER = "support the robot: the other program may hold it up; end it by its own command"
ALONE = (
    "switch torque off and support the robot; make sure that the device is this robot's "
    "and its id unique: the change is permanent"
)
ZERO_MOVES = (
    "support the robot without torque; check which value is meant: angles change, "
    "so calibrate before any motion"
)


class Severity(Enum):
    """Severity of a finding.

    `FAULT`: it does not work, or is dangerous. `WARNING`: it works badly, or will stop to work.
    `NOTE`: information; notes alone leave the exit code at 0.
    """

    FAULT = "fault"
    WARNING = "warning"
    NOTE = "note"


class Devices(str):
    """Devices of one bus, as text and as ids: "bus main ids 1 (neck), 7 (l_knee)"."""

    bus: str
    members: tuple[tuple[int, str], ...]  # id and joint name; "": no joint of the robot has this id

    def __new__(cls, bus: str, members: Sequence[tuple[int, str]]) -> "Devices":
        """`members`: id and joint name of each device, at least one."""
        names = [f"{id} ({joint})" if joint else str(id) for id, joint in members]
        made = super().__new__(cls, f"bus {bus} {'id' if len(names) == 1 else 'ids'} {', '.join(names)}")
        made.bus = bus
        made.members = tuple(members)
        return made

    @property
    def ids(self) -> tuple[int, ...]:
        """Ids in the order of the text."""
        return tuple(id for id, _ in self.members)


@dataclass(frozen=True, slots=True)
class Check:
    """Row of the table. It is true of every machine, so placeholders are in capitals (PORT, FILE, USER)."""

    code: str  # PORT_MISSING; argument of `--only`
    title: str  # the defect
    why: str  # its consequence
    remedy: str  # what to do, commands in backquotes
    severity: Severity
    caution: str = ""  # what to make sure of before any remedy or command; "": a wrong remedy does no harm
    explains: tuple[str, ...] = ()  # codes that often follow from it: printed after it


@dataclass(frozen=True, slots=True)
class Fix:
    """Action of `--fix` for one finding. It moves nothing, changes no torque and loses nothing."""

    text: str  # "set the timer to 1 ms": printed before it is done
    do: Callable[[], None]  # raises OSError, ClientError, PortError or Rejected with the reason of a failure
    thing: str = ""  # what is changed, where `text` does not name it

    def __str__(self) -> str:
        return f"{self.thing}: {self.text}" if self.thing else self.text


@dataclass(frozen=True, slots=True)
class DoctorFinding:
    """Defect on this machine. `measured` and `expected` are texts with units."""

    code: str  # code of its row
    thing: str  # "/dev/ttyUSB0"; for devices on a bus a `Devices`
    measured: str  # "latency timer 16 ms"
    expected: str = ""  # "1 ms"
    command: str = ""  # shell commands that mend it; "": no command can
    fix: Fix | None = None  # None: `--fix` leaves it alone
    advice: str = ""  # what to do beside or without a command; "": the remedy of the row
    severity: Severity | None = None  # None: that of the row
    caution: str | None = None  # None: that of the row; "": none is needed


class CheckNotApplicable(TwindError):
    """This machine or robot has no such subject (no CAN bus). The report leaves it out."""


def severity_of(found: DoctorFinding, rows: Mapping[str, Check]) -> Severity:
    """Return the severity of a finding: its own, else that of its row."""
    return found.severity or rows[found.code].severity


def caution_of(found: DoctorFinding, rows: Mapping[str, Check]) -> str:
    """Return the caution of a finding: its own, else that of its row."""
    return rows[found.code].caution if found.caution is None else found.caution


def merge_findings(found: Iterable[DoctorFinding]) -> Iterator[DoctorFinding]:
    """Join equal findings about more than `MANY` devices of one bus; one fix then mends them all."""
    groups: dict[tuple[object, ...], list[DoctorFinding]] = {}
    for each in found:
        key = (each.code, _devices(each).bus, each.measured, each.expected, each.fix is None)
        groups.setdefault(key, []).append(each)
    for same in groups.values():
        yield from same if len(same) <= MANY else [_joined(same)]


def _devices(found: DoctorFinding) -> Devices:
    """Return the devices of a finding. Raises TypeError: it is about something else."""
    if not isinstance(found.thing, Devices):
        raise TypeError(f"{found.code}: {found.thing!r} names no devices of a bus")
    return found.thing


def _joined(same: list[DoctorFinding]) -> DoctorFinding:
    thing = Devices(_devices(same[0]).bus, [member for each in same for member in _devices(each).members])
    fixes = [each.fix for each in same if each.fix is not None]
    commands = "\n".join(each.command for each in same if each.command)
    # Each fix does the same to its own device.
    fix = Fix(fixes[0].text, lambda: _do_all(fixes), thing) if fixes else None
    return replace(same[0], thing=thing, command=commands, fix=fix)


def _do_all(fixes: Iterable[Fix]) -> None:
    for each in fixes:
        each.do()
