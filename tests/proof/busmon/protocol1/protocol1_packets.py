"""Packets of the first protocol, as Feetech servos and Dynamixels before 2.0 have them, read on its own.

`FF FF | id | length | instruction or error | ... | checksum`. Sources: Dynamixel Protocol 1.0 (e-manual),
memory tables of STS3215 and MX-28.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from tests.proof.busmon.packet import Malformed

PING = 0x01
READ = 0x02
WRITE = 0x03
REBOOT = 0x08
SYNC_READ = 0x82
SYNC_WRITE = 0x83
BULK_READ = 0x92
NAMES = {
    PING: "ping",
    READ: "read",
    WRITE: "write",
    REBOOT: "reboot",
    SYNC_READ: "sync read",
    SYNC_WRITE: "sync write",
    BULK_READ: "bulk read",
}
BROADCAST = 254
SMALLEST = 6


@dataclass(frozen=True)
class Registers:
    """Facts of a memory table that a bus monitor needs."""

    instructions: frozenset[int]
    stored: int  # registers below survive power-off
    torque: int
    goal: int
    position: int
    lock: int | None  # None: no register decides whether those below `stored` are stored
    locked: int  # value of `lock` at which the registers below `stored` are not stored
    sign: int  # bit of the sign of a position; 0: none
    ram: Mapping[int, int]  # address: size, of what may be written under torque
    copies: frozenset[int] = field(default=frozenset())  # below `stored`, of which RAM has a copy that counts


STS = Registers(
    frozenset((PING, READ, WRITE, REBOOT, SYNC_READ, SYNC_WRITE)),
    stored=40,
    torque=40,
    goal=42,
    position=56,
    lock=55,
    locked=1,
    sign=15,
    ram={40: 1, 41: 1, 42: 2, 44: 2, 46: 2, 48: 2, 55: 1},
    copies=frozenset((21, 22, 23)),
)
MX = Registers(
    frozenset((PING, READ, WRITE, SYNC_WRITE, BULK_READ)),
    stored=24,
    torque=24,
    goal=30,
    position=36,
    lock=None,
    locked=1,
    sign=0,
    ram={24: 1, 26: 1, 27: 1, 28: 1, 30: 2, 32: 2, 34: 2},
)


@dataclass(frozen=True)
class Command:
    """An instruction packet, decoded. `rows`: id, address, data of a write; `reads`: id, address, size."""

    instruction: int
    rows: tuple[tuple[int, int, bytes], ...] = ()
    reads: tuple[tuple[int, int, int], ...] = ()

    @property
    def name(self) -> str:
        """Instruction as the manual calls it."""
        return NAMES[self.instruction]

    @property
    def writes(self) -> bool:
        """True: it changes something."""
        return self.instruction in (WRITE, SYNC_WRITE, REBOOT)


def size_of(data: bytes, at: int) -> int:
    """Size of the packet that begins there; 0: it is not whole. Raises Malformed: none begins there."""
    if data[at : at + 2] != b"\xff\xff"[: len(data) - at]:
        raise Malformed("no header", 1)
    if len(data) - at < 4:
        return 0
    id, length = data[at + 2], data[at + 3]
    if id > BROADCAST or length < 2:
        raise Malformed(f"id {id}, length {length}", 4)
    return 0 if len(data) - at < length + 4 else length + 4


def is_sound(packet: bytes) -> bool:
    """Check the checksum of a whole packet."""
    return sum(packet[2:]) & 0xFF == 0xFF


def command(packet: bytes) -> Command:
    """Decode a whole packet. Raises Malformed."""
    if not is_sound(packet):
        raise Malformed("wrong checksum", len(packet))
    id, code, params = packet[2], packet[4], packet[5:-1]
    if code == PING and not params:
        return Command(code, reads=((id, 0, 0),))
    if code == REBOOT and not params:
        return Command(code, rows=((id, 0, b""),))  # it has no reply
    if code == READ and len(params) == 2:
        return Command(code, reads=((id, *params),))
    if code == WRITE and len(params) > 1:
        return Command(code, rows=((id, params[0], params[1:]),))
    if id == BROADCAST and code == SYNC_READ and len(params) > 2:
        return Command(code, reads=tuple((each, params[0], params[1]) for each in params[2:]))
    if id == BROADCAST and code == SYNC_WRITE and len(params) > 2 and not (len(params) - 2) % (params[1] + 1):
        step = params[1] + 1
        each = [params[at : at + step] for at in range(2, len(params), step)]
        return Command(code, rows=tuple((row[0], params[0], row[1:]) for row in each))
    if id == BROADCAST and code == BULK_READ and len(params) > 3 and not params[0] and len(params) % 3 == 1:
        each = [params[at : at + 3] for at in range(1, len(params), 3)]
        return Command(code, reads=tuple((row[1], row[2], row[0]) for row in each))
    raise Malformed(f"instruction {code:#x} with {len(params)} parameters", len(packet))


def position(registers: Registers, data: bytes) -> int:
    """Decode a position or a goal: sign and magnitude, or unsigned."""
    word = int.from_bytes(data[:2], "little")
    mask = 1 << registers.sign if registers.sign else 0
    return -(word & ~mask) if word & mask else word
