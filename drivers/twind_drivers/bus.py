"""Bus contract between the loop and every actuator driver: reader, scripts, samples, errors.

A driver works in raw counts and registers. Radians, joint names and files do not occur in it. Time is an
argument. `twind.exceptions` draws the tree of errors.

A bus carries **one transaction at a time**. The loop begins it: `request` for the cyclic reading, `begin` for
the rare path. It calls `feed` until that returns True or `deadline` passes, then ends it: `finish`, `answer`.
Work of several transactions (identify, prepare, torque) is a **script**: a generator that yields one request
and is sent its reply. The loop steps it, one transaction per tick.

The `BusReader` exists in mirror and live, the `BusWriter` (`bus_writer`) in live only: a mirror has no object
that could write.
"""

from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from math import inf
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from twind.exceptions import TwindError
from twind_drivers.clock import WaitableSource
from twind_drivers.device_registers import RegisterAddress

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]


class BusError(TwindError):
    """A bus that did not do what was requested."""


class PortErrorCause(StrEnum):
    """Cause of a PortError, as far as a caller reacts to it."""

    OTHER = "other"
    IN_USE = "in use"  # by another process
    BAUD_RATE = "baud rate"  # adapter or driver does not support the requested one
    OUTPUT_FULL = "output full"  # the rest of the output was dropped, nothing was sent
    LOST = "lost"  # the port is gone


class PortError(BusError):
    """A port that cannot be opened or used."""

    def __init__(self, port: str, reason: str, kind: PortErrorCause = PortErrorCause.OTHER) -> None:
        super().__init__(f"{port}: {reason}")
        self.port = port
        self.reason = reason
        self.kind = kind

    @property
    def lost(self) -> bool:
        """True if the port is gone."""
        return self.kind is PortErrorCause.LOST


class NoReply(BusError):
    """Required replies of `ids` that did not come within `waited` s."""

    def __init__(self, port: str, ids: Sequence[int], waited: float, what: str = "request") -> None:
        super().__init__(f"{port}: no reply to {what} from {list(ids)} within {waited * 1e3:.1f} ms")
        self.port = port
        self.ids = tuple(ids)
        self.waited = waited
        self.what = what

    def joined(self, earlier: "NoReply | None") -> "NoReply":
        """Return one error for the devices of `earlier` and of this one; None: there are none before."""
        if earlier is None:
            return self
        what = earlier.what if self.what in earlier.what else f"{earlier.what} or {self.what}"
        return NoReply(self.port, (*earlier.ids, *self.ids), earlier.waited + self.waited, what)


class DeviceRefused(BusError):
    """Device that reported an error, or holds another value than was written."""

    def __init__(self, port: str, id: int, what: str, reason: str) -> None:
        super().__init__(f"{port}: id {id}: {what}: {reason}")
        self.port = port
        self.id = id
        self.what = what
        self.reason = reason


class WireRangeError(BusError):
    """Encoded packet outside its permitted range (WIRE_CLAMP), not sent. It shows a defect of twind."""

    def __init__(
        self, port: str, id: int, value: float, lower: float, upper: float, what: str = "goal"
    ) -> None:
        super().__init__(f"{port}: id {id}: {what} {value} outside {lower}..{upper}; packet not sent")
        self.port = port
        self.id = id
        self.value = value
        self.lower = lower
        self.upper = upper


@dataclass(frozen=True, slots=True)
class BusSample:
    """One cyclic reading of one bus, in the order of the bus's ids. Raw units; arrays are (m,).

    Where `heard` is False the numbers are meaningless (zero) and must not be read as values.
    """

    sent: float  # s, when the request went out
    received: float  # s, when the last byte of the reading arrived
    position: Ints  # ticks
    velocity: Ints  # raw
    effort: Ints  # raw (current or load)
    error: NDArray[np.uint8]  # error byte of each status; bit 7 (0x80) = alert
    heard: Bools  # this device answered in this exchange
    # (m,) False: parked. Such a device missed several requests; it is left out and probed once a second.
    asked: Bools
    discarded: int  # bytes that were not the outstanding reply and were dropped (RX_SHAPE)
    # Valid unrequested packets since the last sample (FOREIGN_TRAFFIC): of ids not on this bus, second
    # statuses of one device, another master's instructions, statuses while nothing was outstanding.
    foreign: int
    effort_told: Bools | None = None  # (m,) devices that reported an effort; None: all with `heard`
    # Of the controller (CAN): 0 active, 1 error passive, 2 off the wire or alone (CAN_BUS_STATE).
    line: int = 0
    # Since the last sample: data bytes of each status that a sensor sent out of its turn. They are neither
    # foreign nor discarded: a sensor's delay is no fault of the servos.
    late: tuple[int, ...] = ()


TRIPPED = 255  # value of a device's watchdog register after it has tripped (e-manual, Bus Watchdog)


@dataclass(slots=True)
class SlowRegisterValues:
    """The slowly read state of each device of a bus, in the order of its ids; `nan`/-1 until first read."""

    torque: NDArray[np.int8]  # 1 on, 0 off, -1 unknown
    fault: NDArray[np.int16]  # hardware error bits, -1 unknown
    watchdog: NDArray[np.int16]  # raw; 255 = tripped, 0 = off, -1 unknown
    voltage: Floats  # V
    temperature: Floats  # °C
    tick: NDArray[np.int32]  # ms, the device's own clock modulo 32768; -1 unknown; of `health_time`
    status_time: Floats  # s, when torque, fault and watchdog were read; -inf never
    health_time: Floats  # s, when voltage, temperature and tick were read; -inf never
    version: int = 0  # counts the changes: whoever writes to an array increments it

    def expire_torque(self, rows: int | slice | Bools) -> None:
        """Set torque to unknown: an earlier reading must not pass for the new state."""
        self.torque[rows] = -1
        self.version += 1

    def trip(self, rows: Bools) -> None:
        """Set the watchdog of devices `rows` (m,) to tripped, as if each had reported it."""
        news = rows & (self.watchdog != TRIPPED)
        if news.any():
            self.watchdog[news] = TRIPPED
            self.version += 1

    @classmethod
    def unknown(cls, count: int) -> "SlowRegisterValues":
        """Return the values of `count` devices before their first reading."""
        return cls(
            torque=np.full(count, -1, np.int8),
            fault=np.full(count, -1, np.int16),
            watchdog=np.full(count, -1, np.int16),
            voltage=np.full(count, np.nan),
            temperature=np.full(count, np.nan),
            tick=np.full(count, -1, np.int32),
            status_time=np.full(count, -np.inf),
            health_time=np.full(count, -np.inf),
        )


@dataclass(frozen=True, slots=True)
class IdentifiedDevice:
    """Identification of one device: its identity and the settings that a calibration depends on."""

    id: int
    model_number: int
    model_name: str | None  # None: not in the vendor's tables
    firmware: int
    # register name in snake case -> value, signed where the register is: homing_offset, drive_mode,
    # operating_mode, min_position_limit, max_position_limit, return_delay_time, status_return_level, ...
    settings: Mapping[str, int] = field(default_factory=dict)
    unique_id: str | None = None  # unique within its family; None: it reports none


@dataclass(frozen=True, slots=True)
class PingRequest:
    """Ping of one device, to detect its presence. Read-only."""

    id: int


@dataclass(frozen=True, slots=True)
class ReadRequest:
    """Read of `size` bytes from `address` of each of `ids`, in one transaction."""

    ids: tuple[int, ...]
    address: int
    size: int


@dataclass(frozen=True, slots=True)
class WriteRequest:
    """Write of raw bytes to `address` of each id. One id: acknowledged. Several: one packet without reply."""

    data: Mapping[int, bytes]
    address: int


@dataclass(frozen=True, slots=True)
class GroupWriteBatch:
    """Group writes that leave in one system call, in this order, without reply.

    One system call leaves no gap in which a device runs with only part of the registers written.
    """

    writes: tuple[WriteRequest, ...]


@dataclass(frozen=True, slots=True)
class RebootRequest:
    """Restart of one device: its RAM returns to defaults, its torque is lost."""

    id: int


Query = PingRequest | ReadRequest
Order = WriteRequest | GroupWriteBatch | RebootRequest
Request = Query | Order


@dataclass(frozen=True, slots=True)
class RequestReply:
    """Reply to one rare-path request. Ids that are missing here did not reply."""

    data: Mapping[int, bytes]  # id -> payload (empty for a write or reboot)
    error: Mapping[int, int]  # id -> error byte, for every id that answered
    waited: float  # s from the request to the end of the transaction
    strays: int  # bytes that were no part of the answer


T = TypeVar("T")
Script = Generator[Request, RequestReply, T]


class PortHandle(WaitableSource, Protocol):
    """Port of a bus as the loop uses it: wait for it, name it, close it."""

    name: str  # for error messages
    warning: str  # a fault under which the port still works, with its remedy; empty: none

    def close(self) -> None:
        """Release the port. May be called twice."""


class BusReader(Protocol):
    """Reading half of a driver, all that a mirror has. `ids` fixes the order of every array.

    Wide, since one bus serves all at once: cyclic reading, rare path and its times, identification, doctor.
    """

    name: str
    ids: tuple[int, ...]

    @property
    def registers(self) -> SlowRegisterValues:
        """Slowly read state of each device, as last read."""

    @property
    def transport(self) -> PortHandle:
        """Port of the bus, for bytes or frames."""

    @property
    def deadline(self) -> float:
        """Latest end of the outstanding transaction, s. `feed` may move it, in a chain of single reads."""

    @property
    def earliest(self) -> float:
        """Time of the first `feed` that is worthwhile, s; -inf: unknown. An earlier one only costs time."""

    def request(self, now: float, latest: float = -inf) -> None:
        """Begin the cyclic reading: pending goals and the read request leave in one write.

        `latest`: s, until when a reply may come where the reader's own slack ends earlier.
        """

    def feed(self, now: float) -> bool:
        """Process received bytes; return True when the outstanding transaction is complete."""

    def finish(self, now: float) -> BusSample:
        """End the cyclic reading with the received replies. Never raises for a silent device."""

    def begin(self, query: Query, now: float, latest: float = -inf) -> None:
        """Begin one rare-path transaction. Accepts queries only: a reader cannot write.

        `latest`: as of `request`.
        """

    def answer(self, now: float) -> RequestReply:
        """End the transaction. Never raises for a silent device. Status registers read go to `registers`."""

    def upkeep(self, now: float) -> Query | None:
        """Return the request beside the cyclic reading; None: nothing in this turn.

        Slow registers in turn; once a second, the parked devices.
        """

    def span(self, query: Request) -> float:
        """Return the upper bound of a transaction's bus time (s), its timeout excluded."""

    @property
    def lags(self) -> bool:
        """Return True if the cyclic reading takes longer than a cycle with the settings of the devices."""

    @property
    def late_replies(self) -> Sequence[float]:
        """Delays (s) from request to reply, of replies that came too late since identification began."""

    def identify(self, *, patient: bool = False) -> Script[tuple[IdentifiedDevice, ...]]:
        """Ping every id and read its settings; return the devices that reply, in order of `ids`.

        `patient`: wait for each reply as long as the largest possible return delay. The cyclic reading must
        rest until the script has ended.
        """

    def read(self, id: int, name: str) -> Script[RegisterAddress]:
        """Read one register by its name. Raises NoReply, DeviceRefused, KeyError (lists similar names)."""

    def keeps(self, id: int, name: str) -> bool:
        """Return whether a value written to that register survives power-off. Raises KeyError."""
