"""One bus and its states: closed → open → identified → lost → reopened. Runs scripts, one transaction a tick.

Works in ticks and device ids; `hardware.py` converts to radians. Blocks only while a port opens.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum, auto
from math import inf
from statistics import quantiles
from typing import Any, TypeVar

from twind.loop.bus.bus_tap import BusTap
from twind.loop.bus.script_run import ScriptRun
from twind.robot.arrays import every, some
from twind_drivers.bus import (
    BusError,
    BusReader,
    BusSample,
    IdentifiedDevice,
    Order,
    PingRequest,
    PortError,
    Query,
    ReadRequest,
    Request,
    Script,
)
from twind_drivers.bus_writer import BusWriter

T = TypeVar("T")

Opener = Callable[[str], BusReader]  # bus name -> reader; raises PortError
Enabler = Callable[[BusReader], BusWriter]  # makes the writer; called in mode live only

# s between attempts to open. A faster retry costs ticks, as opening blocks; at the latest 1 s after the node
# returns the robot must be identified.
REOPEN_FIRST = 0.1
REOPEN_MOST = 0.5
# s between identifications while devices are missing; each takes bus time from the cyclic reading
IDENTIFY_AGAIN = 1.0
LATE_REPLIES = 3  # replies that came too late, from which on a bus counts as slow
QUEUE = 16  # scripts that may wait on one bus; a further one is refused, so that a client cannot delay others
# Ticks without room that a script or a slice of upkeep waits: after SOON it may use the spare time at the end
# of a tick; after PATIENCE it begins even if the tick ends late. Replies can be late for a long time (an
# adapter that holds them back, an overloaded machine). Without this bound the registers that report lost
# torque would never be read.
SOON = 2
PATIENCE = 8


class PortState(Enum):
    """Progress of a port from closed to connected."""

    CLOSED = auto()
    IDENTIFYING = auto()
    CONNECTED = auto()


@dataclass(frozen=True, slots=True)
class PortLost:
    """Report that the port of a bus was lost in this tick."""

    bus: str
    error: PortError


@dataclass
class BusCounters:
    """Counters of a bus since the start."""

    exchanges: int = 0
    errors: int = 0  # exchanges in which a device did not reply, and ports lost
    discarded: int = 0  # bytes that belonged to no expected reply
    busy: float = 0.0  # s of the last tick that the bus was in use


@dataclass(eq=False)
class BusPort:
    """One bus by name: its reader while it is open, its writer while the mode is live."""

    name: str
    where: str | None  # the port's path, None: no port given
    opener: Opener
    enabler: Enabler
    tape: BusTap = field(default_factory=BusTap)
    alert_register: str = ""  # of its family: explains an alert; empty: no reply has one
    link: PortState = PortState.CLOSED
    reader: BusReader | None = None
    writer: BusWriter | None = None
    prepared: bool = False  # its devices were prepared for torque, or are about to be, and not lost since
    holding: bool = False  # goals are written here: armed, and not lost since
    devices: tuple[IdentifiedDevice, ...] = ()
    trouble: str = ""  # why it is not open; text for people
    beside: str = ""  # problem of a further device on this bus, such as the IMU; text for people
    counts: BusCounters = field(default_factory=BusCounters)
    tasks: list[ScriptRun[Any]] = field(default_factory=list)
    identification: ScriptRun[tuple[IdentifiedDevice, ...]] | None = None
    patient: bool = False  # identification waits for the slowest return delay
    _holed: bool = False  # in the last cyclic reading a device did not reply ...
    _missed: bool = False  # ... although it was requested
    _begun: tuple[int, int] = (0, 0)  # exchanges and discarded bytes when identification began
    _retry: float = -inf
    _wait: float = REOPEN_FIRST
    _current: ScriptRun[Any] | None = None
    querying: bool = False  # the rare transaction expects a reply, which takes time
    _upkeep: bool = False  # upkeep precedes the scripts this time
    due_upkeep: Query | None = None  # a slice of upkeep that is due and has not begun
    _waited: int = 0  # ticks that it has found no room ...
    _queued: int = 0  # ... and that the first script has found none
    _span: float = 0.0  # s of bus time of the rare transaction ...
    _late: float = 0.0  # ... and the time that the last reply took beyond it

    # ------------------------------------------------------------------------------- open and lost

    def open(self, now: float) -> bool:
        """Try to open the port when it is time; True when it was just opened. Identification begins."""
        if self.reader is not None or self.where is None or now < self._retry:
            return False
        try:
            self.reader = self.opener(self.name)
        except PortError as error:
            self.trouble = str(error)
            self._retry, self._wait = now + self._wait, min(self._wait * 2, REOPEN_MOST)
            return False
        self.trouble = ""
        self._wait = REOPEN_FIRST
        self.tape.opened(self.where)
        self.identify()
        return True

    def enable(self, on: bool) -> None:
        """Make the writer, or drop it: in mode mirror no object exists that could write."""
        if not on:
            self.writer = None
        elif self.reader is not None and self.writer is None:
            self.writer = self.enabler(self.reader)

    def identify(self, *, patient: bool = False) -> None:
        """Identify all devices; `identification` is done some ticks later.

        A running identification begins anew: its replies may come from servos that have restarted since.
        `patient`: wait for the slowest return delay.
        """
        if self.reader is not None:
            if self.identification is not None:
                self.identification.cancel(BusError(f"{self.name}: all devices are identified anew"))
            self.link = PortState.IDENTIFYING
            self._begun = (self.counts.exchanges, self.counts.discarded)
            self.patient = patient
            self.tape.identifying()
            self.identification = self.run(self.reader.identify(patient=patient))

    @property
    def resting(self) -> bool:
        """True while the bus gets no cyclic reading: it is not identified and gets no goals.

        The replies would last longer than a tick and collide with the next request.
        """
        if self.link is not PortState.IDENTIFYING or self.holding or self.reader is None:
            return False
        identification = self.identification
        no_reply = self.patient or (self._holed and not self.devices)
        return self.reader.lags or (no_reply and identification is not None and not identification.done)

    @property
    def warning(self) -> str:
        """Warning of a bus that is open and works, with the remedy; empty: none."""
        warnings = ("", "") if self.reader is None else (self.reader.transport.warning, self.beside)
        return "; ".join(filter(None, warnings))

    @property
    def readings(self) -> int:
        """Cyclic readings since identification began."""
        return self.counts.exchanges - self._begun[0]

    @property
    def strays(self) -> int:
        """Bytes since identification began that belonged to no expected reply."""
        return self.counts.discarded - self._begun[1]

    @property
    def late_reply(self) -> tuple[float, float] | None:
        """Quartile and median delay (s) of the replies too late for an identification; None: too few.

        A connected bus has none: a few late ones in an hour are no fault of adapter or servo.
        A delay is measured too long where the next request read the bytes, or other replies came before.
        """
        identifying = self.link is PortState.IDENTIFYING
        delays = () if self.reader is None or not identifying else self.reader.late_replies
        if len(delays) < LATE_REPLIES:
            return None
        quarter, half, _ = quantiles(delays)
        return quarter, half

    def lose(self, error: PortError, now: float) -> None:
        """Close the port at once and retry soon.

        With an open descriptor the replugged adapter gets another ttyUSB number.
        """
        self._discard_port(error)
        self.trouble = str(error)
        self.counts.errors += 1
        self._retry = now + REOPEN_FIRST
        self._wait = REOPEN_FIRST

    def close(self) -> None:
        """Close the port, for good or until the mode needs it again."""
        if self.reader is not None:
            self._discard_port(PortError(self.reader.transport.name, "closed"))
            self.trouble = ""
            self._retry = -inf
            self._wait = REOPEN_FIRST

    def _discard_port(self, error: PortError) -> None:
        if self.reader is not None:
            self.reader.transport.close()
            self.tape.record_close(str(error))
        self.reader = self.writer = None
        self.prepared = self.holding = self._holed = self._missed = False
        self.link = PortState.CLOSED
        self.devices = ()
        self.beside = ""
        # Requests in flight belong to the lost connection; a reply after reopening belongs to another
        # request.
        self._current = self.identification = self.due_upkeep = None
        self._waited = self._queued = 0
        for task in self.tasks:
            task.cancel(error)
        self.tasks.clear()

    # ------------------------------------------------------------------------------- scripts

    def run(self, script: Script[T], *, urgent: bool = False) -> ScriptRun[T]:
        """Queue a script; an urgent one goes before the others."""
        task = ScriptRun(script, urgent)
        task.advance(None)
        if not task.done:
            self.tasks.insert(0 if urgent else len(self.tasks), task)
        return task

    @property
    def busy(self) -> bool:
        """True while a requested script waits or is under way; identification does not count."""
        return any(not task.done and task is not self.identification for task in self.tasks)

    @property
    def hurried(self) -> bool:
        """True when a waiting script changes torque: nothing goes before it."""
        return any(task.urgent and not task.done for task in self.tasks)

    @property
    def wants_time(self) -> bool:
        """True when the cyclic reading must leave time: a device may be silent again, or requests wait."""
        waits = self._waited >= SOON or self._queued >= SOON
        return waits or self._missed or (bool(self.tasks) and self.hurried)

    @property
    def full(self) -> bool:
        """True when so many scripts wait that another one is refused."""
        return len(self.tasks) >= QUEUE

    def drop(self, reason: str) -> None:
        """Cancel every queued script but identification."""
        for task in [task for task in self.tasks if task is not self.identification]:
            task.cancel(BusError(f"{self.name}: {reason}"))
            self.tasks.remove(task)

    def begin_rare(self, now: float, until: float, last: float = inf, *, upkeep: bool = True) -> bool:
        """Begin one more transaction if it ends before `until`: the next script's, or a slice of upkeep.

        `upkeep`: a new slice may come up in this tick. `last`: s, when the tick ends. Nothing waits longer
        than `PATIENCE` ticks, and a slice that waits stays the next one. Its replies may come until `until`:
        other programs delay them. Not so where a device was silent just before.
        """
        reader = self.reader
        if reader is None:
            return False
        self.tasks[:] = [task for task in self.tasks if not task.done]
        task = self.tasks[0] if self.tasks else None
        alone = task is not None and (
            task.urgent or (self.link is PortState.IDENTIFYING and not self.holding)
        )
        if upkeep and not alone and self.due_upkeep is None:
            # upkeep alternates with scripts, so that the registers that report lost torque are always read
            self._upkeep = task is None or not self._upkeep
            if self._upkeep:
                self.due_upkeep = reader.upkeep(now)
        due = None if alone else self.due_upkeep
        if (
            due is not None
            and (self._upkeep or task is None)
            and self._fits(due, now, until, last, self._waited)
        ):
            self.due_upkeep = None
            self._waited = 0
            self._current = None
            return self._send_query(due, now, -inf if self._missed else until)
        self._waited += due is not None
        if task is None or task.request is None:
            return False
        # An urgent script changes torque: it begins even if this tick ends late, as a stop must not wait.
        if not self._fits(task.request, now, until, last, self._queued) and not task.urgent:
            self._queued = self._queued + 1
            self._upkeep = due is not None
            return False
        self._queued = 0
        self._current = task
        self._upkeep = due is not None
        if isinstance(task.request, PingRequest | ReadRequest):
            return self._send_query(task.request, now)
        self.querying = False
        return self._send_order(task.request, task, now)

    def _fits(self, request: Request, now: float, until: float, last: float, waited: int) -> bool:
        """Check that a request ends in time, or has `waited` so many ticks that it begins anyway."""
        self._span = 0.0 if self.reader is None else self.reader.span(request)
        if waited >= PATIENCE or now + self._span <= until:
            return True
        return waited >= SOON and now + self._span + self._late <= last

    def _send_query(self, query: Query, now: float, latest: float = -inf) -> bool:
        self.querying = True
        if self.reader is not None:
            self.reader.begin(query, now, latest)
        return True

    def _send_order(self, order: Order, task: ScriptRun[Any], now: float) -> bool:
        """Begin a write of a script; one that the driver refuses ends its script, not the tick."""
        try:
            if self.writer is None:
                raise BusError(f"{self.name}: opened read-only, {type(order).__name__} refused")
            self.writer.begin(order, now)
        except PortError:
            raise
        except BusError as error:
            task.cancel(error)
            return False
        return True

    def end_rare(self, now: float) -> None:
        """Take the reply and advance the script that waits for it."""
        if self.reader is None:
            return
        reply = self.reader.answer(now)
        task = self._current
        self._current = None
        self.counts.busy = reply.waited + (0.0 if self.resting else self.counts.busy)
        self.counts.discarded += reply.strays
        if reply.data:
            self._late = max(0.0, reply.waited - self._span)
        if task is not None and not task.done:
            task.advance(reply)

    # ------------------------------------------------------------------------------- the cyclic reading

    def finish(self, now: float) -> BusSample | None:
        """End the cyclic reading and count it; the caller decides whether it is an error of the bus."""
        if self.reader is None:
            return None
        sample = self.reader.finish(now)
        self.counts.exchanges += 1
        self._holed = not every(sample.heard)
        self._missed = self._holed and some(sample.asked & ~sample.heard)
        self.counts.discarded += sample.discarded
        self.counts.busy = now - sample.sent
        return sample
