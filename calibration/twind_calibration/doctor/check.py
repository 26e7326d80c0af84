"""What a complaint is, and what it looks like once found. Pure: it looks at nothing and prints nothing.

A `Check` is a row of the table (`host_rows.py`, `robot_rows.py`): what the troubleshooting page says.
A `DoctorFinding` is that complaint met on this machine: about which thing, what was measured, what mends it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum

from twind.exceptions import OperationFailed, TwindError


class Severity(Enum):
    """How bad it is. `FAULT`: it does not work, or it is dangerous. `WARNING`: it works badly, or will not
    for long. `NOTE`: worth knowing; alone it leaves the exit code 0."""

    FAULT = "fault"
    WARNING = "warning"
    NOTE = "note"


class Devices(str):
    """Devices of one bus as text for people, and what it names: "bus main ids 1 (neck), 7 (l_knee)"."""

    bus: str
    members: tuple[tuple[int, str], ...]  # id, and the name of its joint; "": no joint of the robot has it

    def __new__(cls, bus: str, members: Sequence[tuple[int, str]]) -> "Devices":
        """`members`: id and joint name of each, at least one."""
        names = [f"{id} ({joint})" if joint else str(id) for id, joint in members]
        made = super().__new__(cls, f"bus {bus} {'id' if len(names) == 1 else 'ids'} {', '.join(names)}")
        made.bus = bus
        made.members = tuple(members)
        return made

    @property
    def ids(self) -> tuple[int, ...]:
        """The ids, in the order of the text."""
        return tuple(id for id, _ in self.members)


@dataclass(frozen=True, slots=True)
class Check:
    """One row of the table: true of every machine, so placeholders stand in capitals (PORT, FILE, USER)."""

    code: str  # PORT_MISSING; what `--only` takes
    title: str  # what is wrong, as a person would say it
    why: str  # why it matters: what will happen, or already does
    remedy: str  # what to do, with the command in backquotes; for the page
    severity: Severity
    caution: str = (
        ""  # what to make sure of before any remedy or command; "": it harms nothing if it is wrong
    )
    explains: tuple[str, ...] = ()  # codes that are often only its consequence: shown after it, and said so


@dataclass(frozen=True, slots=True)
class Fix:
    """What `--fix` does about one finding. It moves nothing, changes no torque and loses nothing."""

    text: str  # "set /sys/…/latency_timer to 1": said before it is done; of a `thing` without it
    do: Callable[
        [], None
    ]  # does it; raises OSError, ClientError, PortError or Rejected saying why it could not
    thing: str = ""  # what it is done to, where `text` does not name it

    def __str__(self) -> str:
        return f"{self.thing}: {self.text}" if self.thing else self.text


@dataclass(frozen=True, slots=True)
class DoctorFinding:
    """A complaint met here. `measured` and `expected` are texts with units."""

    code: str  # of the complaint
    thing: str  # what it is about: "/dev/ttyUSB0"; of devices on a bus `Devices`
    measured: str  # what is: "latency timer 16 ms"
    expected: str = ""  # what should be: "1 ms"
    command: str = ""  # what to type to mend it, ready to copy; "" where no command can
    fix: Fix | None = None  # None: `--fix` leaves it alone
    advice: str = ""  # what to do where it is no command, or beside it; "" : the row's remedy says it


# A check that cannot look at its subject (no right to, no such file here). No finding: the end reports it.
CheckUnavailable = OperationFailed


class CheckNotApplicable(TwindError):
    """This machine or robot has no such thing (no CAN bus): not looked at, and not worth a word."""
