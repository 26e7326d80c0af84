"""Scan of an undescribed serial bus: every id at every baud rate, with duplicates and unknown devices.

For tools that own the port alone: it takes seconds. Nothing is written to any device. At each rate it checks
for traffic on the line, echo of the adapter and an older protocol, then sends a broadcast ping, if the family
has one. Single pings follow where it has none or that was garbled (or `thorough`). Of every device found it
reads torque and hardware error, and checks that its id is unique.

Two devices with one id (fault 12) show in three ways. Overlapping answers are no sound status. With different
return delays two statuses come. With one model and firmware the pings overlap bit by bit and are sound, but
not the values that differ between two servos: position, time since power-up, voltage, temperature. Two that
agree in all of that cannot be distinguished from one.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import Enum

from twind_drivers.bus import PortError
from twind_drivers.half_duplex import checksum_packet
from twind_drivers.half_duplex.pending_reply import wire
from twind_drivers.servo_tools.prober import SLACK, PortProber, ProbeWindow
from twind_drivers.servo_tools.scan_protocol import OLD_PING, ScanProtocol, ScanStatus, ServoTable

LISTEN = 0.05  # s: a bus with another master is not silent that long
PROBES = 5  # requests per id until a reply is sound: on a noisy line some are, of two devices none is
NOISY = 3  # garbled replies of unique ids from which the line counts as noisy: fewer may be chance
GARBAGE = 8  # garbled single pings in a row from which the line, not an id, is at fault
PATIENCE = 0.03  # s: longer than any latency timer that adapters have as delivered
DIFFERING = ("realtime_tick", "present_position", "present_input_voltage", "present_temperature")
REMEDY = "disconnect one, give the other a free id (`twindctl robot servo`), then connect the first again"


class ScanFaultKind(Enum):
    """Kind of fault of an id, or of a line as a whole."""

    CLASH = "clash"  # two devices with one id
    ECHO = "echo"
    TALK = "talk"  # unrequested traffic
    FOREIGN = "foreign"
    NOISE = "noise"
    OLD = "old"  # protocol 1.0
    LATE = "late"  # one device, whose replies come later than any setting of it explains
    RATE = "rate"  # the adapter refuses this baud rate


@dataclass(frozen=True, slots=True)
class ScanFault:
    """One fault, as data for programs (`kind`, `ids`) and as text for display."""

    kind: ScanFaultKind
    what: str
    remedy: str = ""  # or its likely causes; "": none is known
    ids: tuple[int, ...] = ()  # of kind OLD: the devices that answered

    def __str__(self) -> str:
        return f"{self.what}: {self.remedy}" if self.remedy else self.what


UNSOUND = ScanFault(
    ScanFaultKind.CLASH, "bytes come, but no sound answer", f"two devices with this id? {REMEDY}"
)
LATE = ScanFault(
    ScanFaultKind.LATE,
    "answers come too late",
    "set the adapter's latency timer to 1 ms, and the return delay of the servo to 10 us",
)
TWO = ScanFault(ScanFaultKind.CLASH, "two devices answer as this id", REMEDY)
UNEQUAL = ScanFault(
    ScanFaultKind.CLASH,
    "pings are sound, readings are not",
    f"two devices of one model with this id? {REMEDY}",
)
ECHO = ScanFault(
    ScanFaultKind.ECHO,
    "the adapter returns what is sent (echo)",
    "switch its echo off, or use another adapter",
)
TALK = ScanFault(
    ScanFaultKind.TALK,
    "bytes come without a request",
    "another program or device sends on this line, or noise",
)
FOREIGN = ScanFault(
    ScanFaultKind.FOREIGN,
    "bytes come, but no sound packet",
    "devices at another baud rate, noise, or colliding ids",
)
NOISE = ScanFault(
    ScanFaultKind.NOISE,
    "answers are garbled now and then",
    "noise, a bad connector, or a long cable without its ground",
)


def old_protocol(ids: Sequence[int]) -> ScanFault:
    """Return the fault that the devices `ids` answer an older protocol."""
    what = f"devices answer protocol 1.0 (ids {', '.join(map(str, ids))})"
    return ScanFault(
        ScanFaultKind.OLD,
        what,
        "describe them on a bus of kind dynamixel1 or feetech, or set Dynamixel servos that have it to "
        "protocol 2.0 (register 13)",
        tuple(ids),
    )


@dataclass(frozen=True, slots=True)
class ScannedDevice:
    """One id that answered. Unknown values are None."""

    baud: int
    id: int
    model: int | None
    model_name: str | None  # None: unknown, or not in the vendor's tables
    firmware: int | None
    torque: bool | None
    hardware_error: int | None  # bits of its error register, or of the state in its error byte
    trouble: ScanFault | None = None  # None: nothing wrong was found


@dataclass(frozen=True, slots=True)
class BaudRateScan:
    """Result of the scan at one baud rate."""

    baud: int
    found: tuple[ScannedDevice, ...]
    troubles: tuple[ScanFault, ...]  # of the line as a whole


Tell = Callable[[int, str], None]  # baud, what is being done
AtRate = Callable[[int], PortProber]  # sets the port to a rate; raises PortError where it cannot


def estimate(
    protocol: ScanProtocol,
    baud: int,
    ids: Sequence[int] | None = None,
    *,
    thorough: bool = False,
    timer: float = 0.0,
) -> float:
    """Seconds that one rate takes when little is found and nothing is garbled; `timer` as the prober's."""
    asked = ids_of(protocol) if ids is None else ids
    status = wire(protocol.overhead + protocol.ping_size, baud)
    call = (max(asked) + 1) * (status + protocol.slot) if protocol.slot else 0.0
    each = wire(len(protocol.ping(0)), baud) + 2 * status + 2 * protocol.delay + SLACK + timer
    return LISTEN + call + len(asked) * each * _rounds(protocol, thorough)


def ids_of(protocol: ScanProtocol) -> range:
    """Return every id that a servo can have."""
    return range(protocol.last_id + 1)


def _rounds(protocol: ScanProtocol, thorough: bool) -> int:
    """Return how often each id is asked singly."""
    return int(not protocol.slot) + int(thorough)


def scan(
    at: AtRate,
    bauds: Sequence[int],
    ids: Sequence[int] | None = None,
    *,
    thorough: bool = False,
    tell: Tell = lambda baud, what: None,
) -> Iterator[BaudRateScan]:
    """Scan rate after rate. A rate that the adapter refuses is a fault of that rate; a lost port raises."""
    for baud in bauds:
        tell(baud, "searching")
        try:
            prober = at(baud)
        except PortError as error:
            if error.lost:
                raise
            yield BaudRateScan(baud, (), (ScanFault(ScanFaultKind.RATE, error.reason),))
            continue
        yield scan_rate(prober, ids, thorough=thorough, tell=tell)


def scan_rate(
    prober: PortProber,
    ids: Sequence[int] | None = None,
    *,
    thorough: bool = False,
    tell: Tell = lambda baud, what: None,
) -> BaudRateScan:
    """Scan one baud rate, by default every id. Raises PortError of kind LOST."""
    protocol = prober.protocol
    asked = ids_of(protocol) if ids is None else ids
    troubles = list(_line(prober))
    known: dict[int, bytes] = {}
    garbled: set[int] = set()
    unsound = bool(protocol.slot) and _call_roll(prober, asked, known, garbled)
    unclear = unsound and TALK not in troubles  # unrequested traffic garbles every reply
    garbage = False
    for _ in range(max(_rounds(protocol, thorough), int(unclear))):
        alone = [id for id in asked if id not in known and id not in garbled]
        garbage |= _singly(prober, alone, known, garbled, tell)
    if garbage or (unclear and not known and not garbled):
        troubles.append(FOREIGN)
    found = []
    noise = 0
    for id in sorted(garbled.union(known)):
        tell(prober.baud, f"reading id {id}")
        one, unclear_answers = _look(prober, id, known.get(id), id in garbled)
        if one is not None:
            found.append(one)
            noise += 0 if one.trouble else unclear_answers
    if noise >= NOISY:
        troubles.append(NOISE)
    return BaudRateScan(prober.baud, tuple(found), tuple(troubles))


def _call_roll(prober: PortProber, ids: Sequence[int], known: dict[int, bytes], garbled: set[int]) -> bool:
    """Note who answers a broadcast ping; return True if some replies were unsound."""
    size = prober.protocol.ping_size
    call = prober.roll_call(max(ids))
    replies = [(each.id, each.data) for each in call.statuses if len(each.data) == size]
    first = dict(reversed(replies))  # a second reply of one id changes nothing
    known.update({id: first[id] for id in ids if id in first})
    garbled.update(id for id in known if sum(each == id for each, _ in replies) > 1)
    return call.strays > 0 or len(first) < len(call.statuses)


def _singly(
    prober: PortProber, ids: Sequence[int], known: dict[int, bytes], garbled: set[int], tell: Tell
) -> bool:
    """Ping one id after the other; return True if all replies are garbage: a fault of the line."""
    for done, id in enumerate(ids):
        if done % 16 == 0:
            tell(prober.baud, f"pinging id {id} alone")
        answer, unsound = _ping(prober, id)
        if answer is not None:
            known[id] = answer
        if unsound:
            garbled.add(id)
        if done + 1 == GARBAGE and garbled.issuperset(ids[:GARBAGE]):
            garbled.difference_update(ids[:GARBAGE])
            return True
    return False


def _line(prober: PortProber) -> Iterator[ScanFault]:
    """Yield the faults of the line as a whole: traffic, echo, older protocol."""
    if prober.listen(LISTEN):
        yield TALK
        return
    window = prober.probe_line()
    if prober.echo:
        yield ECHO
    old = sorted(_old_statuses(bytes(window.raw))) if prober.protocol.line_probe == OLD_PING else []
    if old:
        yield old_protocol(old)


def _old_statuses(raw: bytes) -> set[int]:
    """Return the ids of protocol 1.0 statuses in `raw`."""
    return {each.id for each in checksum_packet.find_packets(raw, status=True)}


def _ping(prober: PortProber, id: int) -> tuple[bytes | None, bool]:
    """Return the bytes of a ping's reply (model, firmware), and True if no reply was sound."""
    answer = None
    for _ in range(PROBES):
        window = prober.ping(id)
        sound = _sound(window, id, prober.protocol.ping_size)
        answer = sound[0].data if answer is None and sound else answer
        if not window.strays and len(sound) < 2:  # silence, or one clear answer
            return answer, False
    return answer, True


def _look(
    prober: PortProber, id: int, answer: bytes | None, garbled: bool
) -> tuple[ScannedDevice | None, int]:
    """Read identity, torque and hardware error of one id, and check that it is one device.

    Returns None for a device of another family, and the number of garbled answers.
    """
    protocol = prober.protocol
    nothing = ScannedDevice(prober.baud, id, None, None, None, None, None)
    if answer is None:
        prober.listen(PATIENCE)
        window = prober.ping(id, PATIENCE)
        fault = LATE if _is_late(window, id, protocol.ping_size) else UNSOUND
        return replace(nothing, trouble=fault), 0
    address, size = protocol.identity
    reply = _read(prober, id, address, size) if size else None
    if size and reply is None:
        return replace(nothing, trouble=TWO if garbled else None), 0
    identity = protocol.identify(id, answer if reply is None else reply.data)
    if identity is None:
        return None, 0
    known = identity.table
    trouble, unclear = (TWO, 0) if garbled else _clash(prober, id, known)
    torque = _value(prober, id, known, "torque_enable")
    if protocol.fault_bits:
        error = None if torque is None else torque[1] & protocol.fault_bits
    else:
        state = _value(prober, id, known, "hardware_error_status")
        error = None if state is None else state[0]
    on = None if torque is None else torque[0] == 1
    number, name, firmware = identity.model, identity.model_name, identity.firmware
    return ScannedDevice(prober.baud, id, number, name, firmware, on, error, trouble), unclear


def _clash(prober: PortProber, id: int, known: ServoTable | None) -> tuple[ScanFault | None, int]:
    """Return the evidence for more than one device, None without any; and the number of garbled answers."""
    fields = [] if known is None else [known[name] for name in DIFFERING if name in known]
    if not fields:
        return None, 0
    first = min(field.address for field in fields)
    size = max(field.end for field in fields) - first
    fault: ScanFault | None = UNEQUAL
    unclear = PROBES
    for probe in range(PROBES):
        window = prober.read(id, first, size)
        sound = len(_sound(window, id, size))
        if sound > 1:
            return TWO, probe
        if not window.strays:  # one clear answer, or silence (status return level 0, or too late)
            fault = None
            unclear = probe
            break
    if fault or not sound:
        prober.listen(PATIENCE)  # until the replies to the requests before have come
        if _is_late(prober.read(id, first, size, PATIENCE), id, size):
            fault = LATE
    return fault, unclear


def _value(prober: PortProber, id: int, known: ServoTable | None, name: str) -> tuple[int, int] | None:
    """Return a register and the error byte of the reply; None: no such register, or it is unreadable."""
    if known is None or name not in known:
        return None
    field = known[name]
    reply = _read(prober, id, field.address, field.size)
    return None if reply is None else (field.decode(reply.data), reply.error)


def _read(prober: PortProber, id: int, address: int, size: int) -> ScanStatus | None:
    """Read a block; None: it is not answered (status return level 0)."""
    for _ in range(PROBES):
        sound = _sound(prober.read(id, address, size), id, size)
        if sound:
            return sound[0]
    return None


def _is_late(window: ProbeWindow, id: int, size: int) -> bool:
    """Return True if one device answered clearly, but needed the patience."""
    return window.late and len(_sound(window, id, size)) == 1 and not window.strays


def _sound(window: ProbeWindow, id: int, size: int) -> list[ScanStatus]:
    return [each for each in window.statuses if each.id == id and len(each.data) == size]
