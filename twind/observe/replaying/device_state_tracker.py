"""Changes of the devices on one bus, from its recorded bytes: a servo's registers over time. Pure.

Three kinds of change. A register that only a servo writes (positions, temperatures) is as it was last read. A
register that a host writes (torque, gains, goals) is left to the current host. Where the recording reads
another value than its host wrote, the servo changed it itself, and that happens again. A device that left two
requests unanswered is silent from the first of them until it answers.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from twind.exceptions import OperationFailed
from twind.flight import LOST, OPENED, EntryKind, FlightContents, FlightEntry
from twind.observe.replaying.recorded_exchanges import FIRMWARE, RecordedExchange, exchanges
from twind_drivers.dynamixel.control_tables import ControlTable, TableRegister, table
from twind_drivers.dynamixel.packet import ALERT

JUST = 1e-3  # s before what is first known
SILENT, HEARD, READ, CHANGED, DAMAGED = range(5)


class DeviceEvent(NamedTuple):
    """One thing that happens to one device."""

    time: float  # s
    what: int  # SILENT, HEARD; READ: `data` from `address`; CHANGED: that field by itself; DAMAGED: bits
    id: int
    address: int = 0
    data: bytes = b""


@dataclass(frozen=True)  # no slots: what follows from it is worked out once
class BusTimeline:
    """One bus of a recording. Times are those of the recording, s."""

    name: str
    kept: tuple[RecordedExchange, ...]  # of its last identification, from before the ring perhaps
    told: tuple[RecordedExchange, ...]  # of the ring
    plugs: tuple[tuple[float, bool], ...]  # the port was opened or lost, in time order
    last: float  # of its last entry

    @cached_property
    def tables(self) -> Mapping[int, ControlTable]:
        """Control table of each id that ever reported its model.

        Raises OperationFailed: a model that has no control table.
        """
        try:
            return {id: table(*each) for id, each in self.models.items()}
        except KeyError as error:
            raise OperationFailed(f"bus {self.name}: {error.args[0]}") from None

    @cached_property
    def models(self) -> Mapping[int, tuple[int, int]]:
        """Model number and firmware of each id that ever reported them."""
        said: dict[int, tuple[int, int]] = {}
        for each in (each for exchange in (*self.kept, *self.told) for each in exchange.told):
            number, firmware = said.get(each.id, (-1, 0))
            number = _part(each.address, each.data, 0, 2, number)
            said[each.id] = number, _part(each.address, each.data, FIRMWARE, 1, firmware)
        return {id: each for id, each in said.items() if each[0] >= 0}

    def turns(self) -> list[DeviceEvent]:
        """Everything that happens to its devices, in time order."""
        return sorted(_turns(self), key=lambda each: each.time)

    def plugged(self, time: float) -> bool:
        """Was the port there then? Before the first word of it: as that does not say."""
        before = [there for at, there in self.plugs if at <= time]
        if before:
            return before[-1]
        return not self.plugs or not self.plugs[0][1] or bool(self.kept)


def story(name: str, bus: int, contents: FlightContents) -> BusTimeline:
    """Build the timeline of one bus; `bus` is its place in the robot's order of buses."""
    own = [each for each in contents.entries if each.bus == bus]
    kept = contents.kept.get(bus, ())
    ring = [each for each in own if each.kind in (EntryKind.OUT, EntryKind.IN)]
    first = ring[0].time if ring else float("inf")
    return BusTimeline(
        name,
        tuple(exchanges(each for each in kept if each.time < first)),
        tuple(exchanges(ring)),
        tuple(_plugs(own)),
        own[-1].time if own else 0.0,
    )


BACK = 0.03  # s that a port is there again before it was opened: it is looked for every 0.1 s and more rarely
GONE = 0.001  # s, at most, that it was gone before that was found out


def _plugs(entries: Sequence[FlightEntry]) -> Iterator[tuple[float, bool]]:
    """Yield when the port was lost (False) and back (True), s.

    The loss is half-way between the last byte and its report, at most `GONE` s before that report. The return
    is `BACK` s before the port was opened.
    """
    before = float("-inf")
    for entry in entries:
        word = entry.data if entry.kind == EntryKind.PORT else b""
        if word.startswith(LOST):
            yield max(entry.time - GONE, (before + entry.time) / 2.0), False
        elif word.startswith(OPENED):
            yield entry.time - BACK, True
        before = entry.time


def _part(address: int, data: bytes, wanted: int, size: int, before: int) -> int:
    """Return the number at address `wanted` if `data` from `address` contains it, otherwise `before`."""
    at = wanted - address
    if address < 0 or at < 0 or at + size > len(data):
        return before
    return int.from_bytes(data[at : at + size], "little")


# ------------------------------------------------------------------------------------------ what happens


class DeviceStateTracker:
    """Known state of one device while its exchanges are read in time order."""

    def __init__(self, id: int, made: ControlTable, since: float) -> None:
        """`since`: s, start of the watched time; a register has the value first read from it since then."""
        self.id = id
        self._table = made
        self._since = since
        self._fields: dict[tuple[int, int], list[TableRegister]] = {}
        self._fault = made.fields.get("hardware_error_status")
        self._known: dict[
            str, tuple[float, bytes]
        ] = {}  # of what a host writes: as written or read last, when
        self._alerts_since = float("inf")  # s, when it began to say that something is wrong
        self._bits = 0  # what is wrong since then, as far as it was read
        self._silent = True  # until its first reply
        self._missed_at: float | None = None  # s, since when it leaves questions open

    def missed(self, time: float) -> Iterator[DeviceEvent]:
        """Process a request without a valid answer. One lost answer is no silence yet; the second one in a
        row is."""
        if self._missed_at is None:
            self._missed_at = time
        elif not self._silent:
            self._silent = True
            yield DeviceEvent(self._missed_at, SILENT, self.id)

    def look_away(self, until: float) -> None:
        """Forget the known registers: nothing was recorded until `until` (s), and a host may have written any
        of them."""
        self._known.clear()
        self._since = until

    def written(self, time: float, address: int, data: bytes) -> None:
        """Process a write by the host of the recording: `data` from `address` at `time` (s)."""
        for each in self._host(address, len(data)):
            at = each.address - address
            self._known[each.key] = time, data[at : at + each.size]

    def on_reply(self, time: float, error: int, address: int, data: bytes) -> Iterator[DeviceEvent]:
        """Process an answer of the device at `time` (s); yield the events that follow from it."""
        self._missed_at = None
        if self._silent:
            self._silent = False
            yield DeviceEvent(time, HEARD, self.id)
        alert = error & ALERT != 0
        self._alerts_since = min(self._alerts_since, time) if alert else float("inf")
        self._bits = self._bits if alert else 0
        if address < 0:
            return
        yield DeviceEvent(time, READ, self.id, address, data)
        yield from self._damage(address, data)
        for each in self._host(address, len(data)):
            at = each.address - address
            value = data[at : at + each.size]
            since, before = self._known.get(each.key, (time, None))
            if before is None:
                yield DeviceEvent(self._since, CHANGED, self.id, each.address, value)
            elif value != before:  # no write did that: it changed between the two reads
                yield DeviceEvent((since + time) / 2.0, CHANGED, self.id, each.address, value)
            self._known[each.key] = time, value

    def _damage(self, address: int, data: bytes) -> Iterator[DeviceEvent]:
        """Yield DAMAGED when the fault bits change. They are read after the first alert, and hold since that
        alert."""
        fault = self._fault
        bits = 0 if fault is None else _part(address, data, fault.address, 1, 0)
        if bits != self._bits and self._alerts_since < float("inf"):
            self._bits = bits
            yield DeviceEvent(self._alerts_since, DAMAGED, self.id, data=bytes((bits,)))

    def _host(self, address: int, size: int) -> list[TableRegister]:
        """Registers in RAM that a host writes, of those that lie whole in this span."""
        key = address, size
        if key not in self._fields:
            self._fields[key] = [
                each
                for each in self._table.fields.values()
                if each.rule.writable and not each.eeprom and address <= each.address
                if each.end <= address + size
            ]
        return self._fields[key]


def _turns(story: BusTimeline) -> Iterator[DeviceEvent]:
    begin = min((each.time for each in (*story.kept[:1], *story.told[:1])), default=0.0)
    seen = {id: DeviceStateTracker(id, made, begin - JUST) for id, made in story.tables.items()}
    first = story.told[0] if story.told else None
    for exchange in (*story.kept, *story.told):
        if exchange is first:
            for witness in seen.values():
                witness.look_away(exchange.time - JUST)
        for each in exchange.told:
            if each.id in seen:
                yield from seen[each.id].on_reply(exchange.time, each.error, each.address, each.data)
        for id in exchange.missed:
            if id in seen:
                yield from seen[id].missed(exchange.time)
        for span in exchange.writes:
            if span.id in seen:
                seen[span.id].written(exchange.time, span.address, span.data)
