"""Instruction packets taken apart: who is asked what, who is told what, what of it is never allowed."""

from dataclasses import dataclass, field

import numpy as np

from tests.proof.busmon import allowed
from tests.proof.busmon.limits import Limits
from tests.proof.busmon.packet import BROADCAST, Malformed, open_packet

PING = 0x01
READ = 0x02
WRITE = 0x03
REG_WRITE = 0x04
ACTION = 0x05
FACTORY = 0x06
REBOOT = 0x08
CLEAR = 0x10
BACKUP = 0x20
SYNC_READ = 0x82
SYNC_WRITE = 0x83
FAST_SYNC_READ = 0x8A
BULK_READ = 0x92
BULK_WRITE = 0x93
FAST_BULK_READ = 0x9A
NAMES = {
    PING: "ping",
    READ: "read",
    WRITE: "write",
    REG_WRITE: "reg write",
    ACTION: "action",
    FACTORY: "factory reset",
    REBOOT: "reboot",
    CLEAR: "clear",
    BACKUP: "backup",
    SYNC_READ: "sync read",
    SYNC_WRITE: "sync write",
    FAST_SYNC_READ: "fast sync read",
    BULK_READ: "bulk read",
    BULK_WRITE: "bulk write",
    FAST_BULK_READ: "fast bulk read",
}
WRITES = frozenset((WRITE, REG_WRITE, ACTION, FACTORY, REBOOT, CLEAR, BACKUP, SYNC_WRITE, BULK_WRITE))
READS = frozenset((PING, READ, SYNC_READ, FAST_SYNC_READ, BULK_READ, FAST_BULK_READ))
USED = READS | {WRITE, SYNC_WRITE, REBOOT}
FAST = frozenset((FAST_SYNC_READ, FAST_BULK_READ))
FARTHEST = 1024  # a read beyond it is none of an X series servo


@dataclass
class Request:
    """One instruction packet. `rows`: (id, address, data) of what it writes."""

    instruction: int
    id: int
    wrong: str = ""  # W2, whatever the state
    rows: list[tuple[int, int, bytes]] = field(default_factory=list)
    goals: "np.ndarray | None" = None  # all servos in order of their ids get these
    reads: dict[int, tuple[int, int]] = field(default_factory=dict)  # id -> (address, bytes)
    expected: int = 0  # bytes of the answer, nothing stuffed; 0: none comes
    uniform: "np.dtype | None" = None  # of a block of a fast answer in which all are asked for the same
    eeprom: bool = False
    quiet: bool = False  # writes what may only be written without torque

    @property
    def writes(self) -> bool:
        return self.instruction in WRITES

    @property
    def name(self) -> str:
        return NAMES.get(self.instruction, f"instruction {self.instruction:02x}")


class Parser:
    """Packets of one bus."""

    def __init__(self, limits: Limits) -> None:
        self._servos = limits.servos
        self._sensors = limits.sensors
        self.ids = bytes(sorted(limits.servos))
        self._size = 14 + 5 * len(self.ids)
        self._goal_head = (
            b"\xff\xff\xfd\x00\xfe" + (self._size - 7).to_bytes(2, "little") + b"\x83\x74\x00\x04\x00"
        )
        self._goal_row = np.dtype([("id", "u1"), ("goal", "<i4")])
        self._known: dict[bytes, Request] = {}

    def take(self, packet: bytes) -> Request:
        """Decode it. Raises Malformed."""
        found = self._known.get(packet)
        if found is None:
            found = self._parse(packet)
            if len(self._known) >= 512:
                self._known.clear()
            self._known[packet] = found
        return found

    def _parse(self, packet: bytes) -> Request:
        id, instruction, params = open_packet(packet)
        if len(packet) == self._size and packet[:12] == self._goal_head and packet[12:-2:5] == self.ids:
            words = np.frombuffer(packet, self._goal_row, len(self.ids), 12)["goal"]
            return Request(SYNC_WRITE, BROADCAST, goals=words.astype(np.int64))
        request = Request(instruction, id)
        if instruction not in NAMES:
            request.wrong = f"instruction {instruction:02x}"
            return request
        _PARAMS[instruction](request, params)
        self._judge(request, params)
        return request

    # ------------------------------------------------------------------------- W2, the part without state

    def _judge(self, request: Request, params: bytes) -> None:
        told = [row[0] for row in request.rows] + list(request.reads)
        group = request.instruction in (SYNC_READ, SYNC_WRITE, *FAST, BULK_READ, BULK_WRITE)
        known = self._servos.keys() | (self._sensors if request.instruction == READ else ())
        strange = [id for id in ([*told] if group else [request.id]) if id not in known]
        if request.instruction not in USED:
            request.wrong = f"{request.name} is never used"
        elif group != (request.id == BROADCAST):
            request.wrong = f"{request.name} to id {request.id}"
        elif strange:
            request.wrong = f"{request.name}: id {strange[0]} is not of this bus"
        elif len(set(told)) != len(told):
            request.wrong = f"{request.name}: an id twice"
        elif any(address + size > FARTHEST or not size for address, size in request.reads.values()):
            request.wrong = f"{request.name}: {next(iter(request.reads.values()))}"
        if request.wrong:
            return
        for id, address, data in request.rows:
            request.wrong = request.wrong or allowed.wrong(address, data, self._servos[id].cap)
            request.eeprom |= address < allowed.EEPROM_END
        if request.rows and not request.wrong:
            field = allowed.FIELDS[request.rows[0][1], len(request.rows[0][2])]
            request.quiet = not field.with_torque


# ------------------------------------------------------------------------------ parameters by instruction


def _need(params: bytes, good: bool) -> None:
    if not good:
        raise Malformed(f"the parameters do not fit: {params.hex(' ')}", len(params) + 10)


def _word(params: bytes, at: int) -> int:
    return params[at] | params[at + 1] << 8


def _ping(request: Request, params: bytes) -> None:
    _need(params, not params)
    request.reads = {request.id: (0, 3)}
    request.expected = 14


def _read(request: Request, params: bytes) -> None:
    _need(params, len(params) == 4)
    request.reads = {request.id: (_word(params, 0), _word(params, 2))}
    request.expected = 0 if request.id == BROADCAST else 11 + _word(params, 2)


def _write(request: Request, params: bytes) -> None:
    _need(params, len(params) > 2)
    request.rows = [(request.id, _word(params, 0), params[2:])]
    request.expected = 0 if request.id == BROADCAST else 11


def _plain(request: Request, params: bytes) -> None:
    del params
    request.expected = 0 if request.id == BROADCAST else 11


def _none(request: Request, params: bytes) -> None:
    _need(params, not params)
    _plain(request, params)


def _sync_read(request: Request, params: bytes) -> None:
    _need(params, len(params) > 4)
    span = (_word(params, 0), _word(params, 2))
    request.reads = dict.fromkeys(params[4:], span)
    if request.instruction == FAST_SYNC_READ:
        _fast(request)
        at, size = span
        if at <= 132 and at + size >= 136:
            names = ["err", "id", "position"]
            formats = ["u1", "u1", "<i4"]
            places = [0, 1, 2 + 132 - at]
            request.uniform = np.dtype(
                {"names": names, "formats": formats, "offsets": places, "itemsize": size + 4}
            )
    else:
        request.expected = sum(11 + size for _, size in request.reads.values())


def _fast(request: Request) -> None:
    request.expected = 8 + sum(4 + size for _, size in request.reads.values())


def _sync_write(request: Request, params: bytes) -> None:
    _need(params, len(params) > 5)
    address = _word(params, 0)
    size = _word(params, 2)
    _need(params, size > 0 and (len(params) - 4) % (size + 1) == 0)
    request.rows = [
        (params[at], address, params[at + 1 : at + 1 + size]) for at in range(4, len(params), size + 1)
    ]


def _bulk_read(request: Request, params: bytes) -> None:
    _need(params, len(params) > 0 and len(params) % 5 == 0)
    request.reads = {
        params[at]: (_word(params, at + 1), _word(params, at + 3)) for at in range(0, len(params), 5)
    }
    request.expected = sum(11 + size for _, size in request.reads.values())
    if request.instruction == FAST_BULK_READ:
        _fast(request)


def _bulk_write(request: Request, params: bytes) -> None:
    at = 0
    while at < len(params):
        _need(params, at + 5 < len(params))
        size = _word(params, at + 3)
        _need(params, size > 0 and at + 5 + size <= len(params))
        request.rows.append((params[at], _word(params, at + 1), params[at + 5 : at + 5 + size]))
        at += 5 + size


_PARAMS = {
    PING: _ping,
    READ: _read,
    WRITE: _write,
    REG_WRITE: _write,
    ACTION: _none,
    FACTORY: _plain,
    REBOOT: _none,
    CLEAR: _plain,
    BACKUP: _plain,
    SYNC_READ: _sync_read,
    FAST_SYNC_READ: _sync_read,
    SYNC_WRITE: _sync_write,
    BULK_READ: _bulk_read,
    FAST_BULK_READ: _bulk_read,
    BULK_WRITE: _bulk_write,
}
