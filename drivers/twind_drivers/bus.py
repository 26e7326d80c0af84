"""The contract between the loop and every actuator driver: a reader, a writer, scripts, samples, errors.

A driver speaks ticks and registers; it knows no radians, no joint names, no files. Its time is an argument.

A bus carries **one transaction at a time**. The loop begins one (`request` for the cyclic reading, `begin`
for the rare path), lets `feed` take bytes until it says done or `deadline` passes, and ends it (`finish`,
`answer`). What takes several transactions (identify, prepare, torque) is a **script**: a generator that
yields one request and is sent its reply, so that the loop steps it, one transaction a tick.

The `BusReader` exists in mirror and live, the `BusWriter` in live only: a mirror has no object that could
write.

    BusError
    ├── PortError          the port could not be opened, or was lost (`lost` is True)
    │   └── PortFull       the last packet had not left when the next was due: that one was not sent
    ├── NoReply            nobody answered where somebody must
    ├── DeviceRefused      a device answered with an error, or reads back other than written
    └── WireClamp          a packet of ours failed its own last check and was not sent
"""

from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from twind_drivers.clock import ArrivalSource

if TYPE_CHECKING:
    from twind_drivers.single_device import SingleDeviceControl

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]


# --------------------------------------------------------------------------------------------- errors


class BusError(Exception):
    """The bus did not do what was asked."""


class PortError(BusError):
    """A port that cannot be opened, or that went away."""

    def __init__(self, port: str, reason: str, *, lost: bool = False) -> None:
        super().__init__(f"{port}: {reason}")
        self.port = port
        self.reason = reason
        self.lost = lost


class PortInUse(PortError):
    """Another process has the port."""


class BaudRefused(PortError):
    """The adapter or its driver does not do the baud rate that was asked for."""


class OutputQueueFull(PortError):
    """More than the last packet waited in the port's output: discarded, nothing is sent (TX_BACKLOG)."""

    def __init__(self, port: str, waiting: int, most: int) -> None:
        super().__init__(
            port,
            f"{waiting} bytes still wait in the output, the last packet had {most}: thrown away, nothing "
            "sent; is the adapter stuck, or slower than its baud rate says?",
        )
        self.waiting = waiting
        self.most = most


class NoReply(BusError):
    """Devices that must answer did not answer."""

    def __init__(self, port: str, ids: Sequence[int], waited: float, what: str = "request") -> None:
        super().__init__(f"{port}: no reply to {what} from {list(ids)} within {waited * 1e3:.1f} ms")
        self.port = port
        self.ids = tuple(ids)
        self.waited = waited
        self.what = what


class DeviceRefused(BusError):
    """A device answered with an error, or holds another value than was written."""

    def __init__(self, port: str, id: int, what: str, reason: str) -> None:
        super().__init__(f"{port}: id {id}: {what}: {reason}")
        self.port = port
        self.id = id
        self.what = what
        self.reason = reason


class UnknownRegister(KeyError):
    """A device has no register of that name. `near`: the nearest names that it has."""

    def __init__(self, device: str, name: str, near: Sequence[str] = ()) -> None:
        nearest = f"; near: {', '.join(near)}" if near else ""
        super().__init__(f"{device} has no register {name!r}{nearest}")
        self.near = tuple(near)


class WireClamp(BusError):
    """An encoded packet is outside its permitted range (WIRE_CLAMP). It was not sent: a defect of twind."""

    def __init__(
        self, port: str, id: int, value: float, lower: float, upper: float, what: str = "goal"
    ) -> None:
        super().__init__(f"{port}: id {id}: {what} {value} outside {lower}..{upper}; packet not sent")
        self.port = port
        self.id = id
        self.value = value
        self.lower = lower
        self.upper = upper


# --------------------------------------------------------------------------------------------- data


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
    # False: parked. It stayed silent again and again, so it is left out and probed once a second.
    asked: Bools
    discarded: int  # bytes that were not the outstanding reply and were dropped (RX_SHAPE)
    # Valid unrequested packets since the last sample (FOREIGN_TRAFFIC): of ids that are not ours, second
    # statuses of one device, another master's instructions, statuses while nothing was outstanding.
    foreign: int
    effort_told: Bools | None = None  # who told an effort; None: everybody who was heard
    line: int = (
        0  # of the controller (CAN): 0 active, 1 error passive, 2 off the wire or alone (CAN_BUS_STATE)
    )
    # Since the last sample: data bytes of each status, out of its turn, of a device that only tells. They are
    # neither foreign nor discarded: what such a device does is no fault of the others.
    late: tuple[int, ...] = ()


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

    @classmethod
    def unknown(cls, count: int) -> "SlowRegisterValues":
        """Nothing read yet of `count` devices."""
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
    unique_id: str | None = None  # what no other device of its family has; None: it tells none


@dataclass(frozen=True, slots=True)
class RegisterAddress:
    """One register of one device. `name` as the vendor's control table spells it."""

    name: str
    address: int
    size: int  # bytes
    value: int  # signed where the register is
    eeprom: bool = False  # survives power-off: one of those that identification may have read


@dataclass(frozen=True, slots=True)
class RestartResult:
    """Result of a restart for the settings of a device."""

    restored: tuple[RegisterAddress, ...] = ()  # the restart had changed them; they read back as before it
    differing: tuple[tuple[RegisterAddress, int], ...] = ()  # what reads otherwise, and what it was before


@dataclass(frozen=True, slots=True)
class PingRequest:
    """Ping of one device, to detect its presence. Read-only."""

    id: int


@dataclass(frozen=True, slots=True)
class ReadRequest:
    """`size` bytes from `address` of each of `ids`, in one transaction. Read-only."""

    ids: tuple[int, ...]
    address: int
    size: int


@dataclass(frozen=True, slots=True)
class WriteRequest:
    """Raw bytes to `address` of each id. One id: acknowledged. Several: one group packet, never answered."""

    data: Mapping[int, bytes]
    address: int


@dataclass(frozen=True, slots=True)
class BurstWriteRequest:
    """Group writes that leave in one system call, in this order. Never answered."""

    writes: tuple[WriteRequest, ...]


@dataclass(frozen=True, slots=True)
class RebootRequest:
    """Restart one device: RAM back to defaults, torque lost."""

    id: int


Query = PingRequest | ReadRequest
Order = WriteRequest | BurstWriteRequest | RebootRequest
Request = Query | Order


@dataclass(frozen=True, slots=True)
class RequestReply:
    """Reply to one rare-path request. An id that is missing here did not answer."""

    data: Mapping[int, bytes]  # id -> payload (empty for a write or reboot)
    error: Mapping[int, int]  # id -> error byte, for every id that answered
    waited: float  # s from the request to the end of the transaction
    strays: int  # bytes that were no part of the answer


T = TypeVar("T")
Script = Generator[Request, RequestReply, T]


# --------------------------------------------------------------------------------------------- the two halves


class PortHandle(ArrivalSource, Protocol):
    """What the loop needs of the port under a bus: to wait for it, to name it, to let it go."""

    name: str  # what an error message calls it
    warning: str  # what is wrong with it though it works, and the remedy; empty: nothing

    def close(self) -> None:
        """Let go of the port. May be called twice."""


class ByteTransport(PortHandle, Protocol):
    """A byte stream to a bus: a serial port, or the in-process loopback of the virtual servos."""

    holds: bool  # what is written may wait in it, and `backlog` knows how much

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Send all of `data` in one system call. Raises PortError(lost=True)."""

    def read_into(self, buffer: memoryview) -> int:
        """Bytes taken without blocking; 0 if none are there. Raises PortError(lost=True)."""

    def drain(self, thrown: bytearray | None = None) -> int:
        """Throw away what has arrived; bytes thrown, put into `thrown` too. Called before each request."""

    def backlog(self) -> int:
        """Bytes written that have not left yet; 0 where that is unknown. Raises PortError(lost=True)."""

    def flush(self) -> None:
        """Throw away what has not left yet. Raises PortError(lost=True)."""


class BusReader(Protocol):
    """The half of a driver that only reads, which a mirror has. `ids` fixes the order of every array."""

    name: str
    ids: tuple[int, ...]

    @property
    def registers(self) -> SlowRegisterValues:
        """The slowly read state of each device, as of now."""

    @property
    def transport(self) -> PortHandle:
        """The port under it: bytes, or frames."""

    @property
    def deadline(self) -> float:
        """When the outstanding transaction ends at the latest, s."""

    @property
    def earliest(self) -> float:
        """Before this (s) it cannot be complete: to look sooner only costs. -inf: unknown."""

    def request(self, now: float) -> None:
        """Begin the cyclic reading: pending goals and the read request leave in one write."""

    def feed(self, now: float) -> bool:
        """Take what has arrived; True when the outstanding transaction is complete."""

    def finish(self, now: float) -> BusSample:
        """End the cyclic reading with the received answers. Never raises for a silent device."""

    def begin(self, query: Query, now: float) -> None:
        """Begin one rare-path transaction. Only queries: a reader cannot write."""

    def answer(self, now: float) -> RequestReply:
        """End it. Never raises for a silent device. Status registers seen are kept in `registers`."""

    def upkeep(self, now: float) -> Query | None:
        """Return the request beside the cyclic reading; None: nothing in this turn.

        Slow registers in turn; once a second, the parked devices.
        """

    def span(self, query: Request) -> float:
        """Upper bound of the bus time (s) that a transaction takes, its timeout excluded."""

    @property
    def lags(self) -> bool:
        """As the devices are set, the cyclic reading takes longer than a cycle has."""

    def identify(self, *, patient: bool = False) -> Script[tuple[IdentifiedDevice, ...]]:
        """Ping every id and read its settings; devices that answer, in order of `ids`.

        `patient`: each answer may come as late as a device can be set to send it. The cyclic reading must
        rest until it has ended.
        """

    def read(self, id: int, name: str) -> Script[RegisterAddress]:
        """One register by its name. Raises NoReply, DeviceRefused, KeyError (lists the near names)."""

    def keeps(self, id: int, name: str) -> bool:
        """Return whether a value written to that register survives power-off. Raises KeyError."""


class BusWriter(Protocol):
    """The half that exists in live only."""

    def set_goal_limits(self, lower: Ints, upper: Ints) -> None:
        """Set the range of the goals (m,) (WIRE_CLAMP); drop pending goals. Raises ValueError."""

    def goals(self, ticks: Ints) -> None:
        """Goals (m,) for the next `request`. Raises WireClamp; then nothing is pending."""

    def cut(self) -> None:
        """Torque off for all, in the next write of any kind, before anything else.

        Pending goals are dropped, and goals given before that write are not sent.
        """

    def clear(self) -> None:
        """Drop pending goals: after a fault nothing stale may leave. A pending cut stays."""

    def begin(self, order: Order, now: float) -> None:
        """Begin one rare-path transaction that writes; ended by the reader's `answer`."""

    def prepare(self, ticks: Ints, among: Bools | None = None) -> Script[None]:
        """Before torque: device watchdogs cleared, armed and read back; gains and caps of the output, too.
        Of `among` (m,) alone, None: all; nobody else gets a goal of any kind until prepared himself.

        `ticks` (m,), the present position, becomes the goal in the system call that clears the watchdogs: a
        tripped servo whose torque is still on must not resume its old goal.
        """

    def write_goals(self, ticks: Ints) -> Script[None]:
        """Write goals (m,) and read them back. Raises DeviceRefused on the first that differs."""

    def read_goals(self) -> Script[Ints]:
        """The goals (m,) that the devices hold now, in ticks. Writes nothing. Raises NoReply."""

    def torque(self, on: bool) -> Script[None]:
        """Torque of all devices, read back. Off is written twice. Raises DeviceRefused, NoReply."""

    def damp(self) -> Script[tuple[int, ...]]:
        """Torque stays, soft: output capped, then stiffness down and damping up, read back. RAM only.

        Ids of those that did not confirm it. A part of it leaves nobody stronger than before, and a silent
        device holds nobody up: whoever asks for it goes on to torque off. `prepare` gives the strength back.
        """

    def begin_single_device(self, id: int, *, cap: int, profile: int) -> "SingleDeviceControl":
        """One device by itself, `cap` its most current and `profile` its speed, raw. Until `together` nobody
        else is given anything but torque off. Raises ValueError: it cannot be driven so."""

    def end_single_device(self) -> None:
        """All devices again, as before `alone`."""

    def write(self, id: int, name: str, value: int) -> Script[RegisterAddress]:
        """One register by name, read back. Raises NoReply, DeviceRefused, KeyError, ValueError (range)."""

    def reboot(self, id: int, *, shut_down: bool = False) -> Script[RestartResult]:
        """Restart one device, wait until it answers, give its settings back. Its torque stays off.

        Raises DeviceRefused while its torque is on, unless it is `shut_down` by its hardware error.
        """
