"""Facts of one family of serial servos for scan, adoption and doctor."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from twind.config.driver_family import FamilyPart, families, family
from twind.config.robot_spec import BusSpec, JointSpec
from twind.config.supply_limits import SupplyLimits
from twind_drivers.bus import IdentifiedDevice
from twind_drivers.half_duplex.pending_reply import PendingReply
from twind_drivers.servo_tools.scan_protocol import ScanProtocol, ServoTable

Values = Mapping[str, int]  # register -> counts


@dataclass(frozen=True, slots=True)
class ServoLocation:
    """Id and baud rate at which a servo answers."""

    id: int
    baud: int  # bit/s

    def __str__(self) -> str:
        return f"id {self.id} at {self.baud} baud"


def nothing(values: Values) -> str:
    """Return no objection."""
    return ""


@dataclass(frozen=True, slots=True, kw_only=True)
class FamilyTools:
    """Facts of one family. `device`: the model of a type in a robot file."""

    protocol: ScanProtocol
    number_of: Callable[[str], int]  # model number of a device
    name_of: Callable[[str], str] = str  # its name in identification
    table_of: Callable[[str], ServoTable]  # registers of a device
    reply: Callable[[int, int, bytes], PendingReply]  # to a read: id, data bytes, request
    settings: Callable[[ServoTable], Sequence[str]]  # registers that identification reads
    # Settings with those that no register holds, under the names of other families; error byte of a reply.
    derive: Callable[[Values, int], dict[str, int]]

    # Adoption
    delivered: Callable[[str], Sequence[ServoLocation]]  # where a device may answer as delivered
    baud_code: Callable[[int], int | None]  # content of `baud_rate`; None: not certain
    # What a new servo of a joint must hold; `values`: what it holds. One that has its place needs `demanded`.
    required: Callable[[JointSpec, ServoTable, Values], dict[str, int]]
    refusal: Callable[[int], str]  # why a status with this error byte refuses a write; empty: it does not
    objection: Callable[[Values], str] = nothing  # why nothing can be written now; empty: it can
    locks: bool = False  # `lock` must be 0 while a setting is written, and 1 afterwards

    # Doctor
    errors: Mapping[int, tuple[str, str]]  # bit of an error state -> its name and a remedy
    reboots: bool  # a reboot ends an error
    # What arming needs of a servo of a joint, of those registers that it can read; None: `judges` know.
    demanded: Callable[[JointSpec, ServoTable, Values], dict[str, int]] | None = None
    judges: FamilyPart[Any] | None = None  # further checks: a `servo_tools.doctor.servo_judges.ServoJudges`
    supply: Callable[[str], SupplyLimits] = lambda device: SupplyLimits()  # of a device by its page
    reading_time: Callable[[BusSpec, Sequence[JointSpec]], float]  # s of one plain reading

    def identified(self, id: int, device: str, firmware: int, values: Values) -> IdentifiedDevice:
        """Return a servo of a known model as the daemon would identify it."""
        return IdentifiedDevice(
            id, self.number_of(device), self.name_of(device), firmware, self.derive(values, 0)
        )


def tools_of(kind: str) -> FamilyTools | None:
    """Return the tools of a kind of bus, imported; None: its family has none."""
    part = family(kind).tools
    found: FamilyTools | None = None if part is None else part.load()
    return found


def need_tools(kind: str) -> FamilyTools:
    """Return the tools of a kind of bus that has some."""
    found = tools_of(kind)
    assert found is not None
    return found


def tool_kinds() -> Iterator[str]:
    """Yield the kinds of bus with tools."""
    return (each.kind for each in families() if each.tools is not None)
