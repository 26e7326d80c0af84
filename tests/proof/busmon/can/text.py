"""slcan: lines of text that end with a carriage return, both ways. Strict with what the daemon says."""

from typing import NamedTuple

END = 0x0D
MOST = 8  # bytes of a frame
LETTERS = {0x74: (3, False, False), 0x54: (8, True, False), 0x72: (3, False, True), 0x52: (8, True, True)}
RATES = {10: 0, 20: 1, 50: 2, 100: 3, 125: 4, 250: 5, 500: 6, 800: 7, 1000: 8}  # kbit/s -> S code
SET_UP = (b"", b"C", b"O", b"V", b"v", b"N", b"F", b"Z0", b"M0", b"A0")  # these say nothing on the wire


class Malformed(ValueError):
    """Not a line that may be said."""


class Frame(NamedTuple):
    """One frame."""

    id: int
    extended: bool
    remote: bool
    data: bytes


def _number(text: bytes) -> int:
    """Hexadecimal digits, one by one."""
    value = 0
    for each in text:
        if 0x30 <= each <= 0x39:
            digit = each - 0x30
        elif 0x41 <= each <= 0x46 or 0x61 <= each <= 0x66:
            digit = (each & 0x5F) - 0x37
        else:
            raise Malformed(f"no digit: {text!r}")
        value = value << 4 | digit
    return value


def frame(line: bytes) -> Frame:
    """Decode a line without its end. Raises Malformed."""
    if not line or line[0] not in LETTERS:
        raise Malformed(f"no frame: {line[:40]!r}")
    digits, extended, remote = LETTERS[line[0]]
    if len(line) < digits + 2:
        raise Malformed(f"too short: {line!r}")
    id = _number(line[1 : 1 + digits])
    size = _number(line[1 + digits : 2 + digits])
    if id >= 1 << (29 if extended else 11) or size > MOST:
        raise Malformed(f"id or length out of range: {line!r}")
    body = line[2 + digits :]
    if len(body) != (0 if remote else 2 * size):
        raise Malformed(f"{size} bytes are announced: {line!r}")
    data = bytes(_number(body[at : at + 2]) for at in range(0, len(body), 2))
    return Frame(id, extended, remote, data)


def set_up(line: bytes, baud: int) -> bool:
    """A command to the adapter that may be given. Raises Malformed: another rate than the bus has."""
    if line in SET_UP:
        return True
    if len(line) == 2 and line[:1] == b"S":
        if line[1] - 0x30 != RATES.get(baud // 1000, -1):
            raise Malformed(f"another rate than {baud}: {line!r}")
        return True
    return False


def text(frames: bytes) -> bytes:
    """Lines of frames that stand in memory as the kernel has them (linux/can.h): id and flags, size, three
    bytes of nothing, eight of data. Frames of errors have no line."""
    lines = b""
    for at in range(0, len(frames), 16):
        id = int.from_bytes(frames[at : at + 4], "little")
        size = frames[at + 4]
        if id & 1 << 29:
            continue
        remote = id >> 30 & 1
        extended = id >> 31
        letter = b"tTrR"[2 * remote + extended : 2 * remote + extended + 1]
        number = b"%08X" % (id & 0x1FFFFFFF) if extended else b"%03X" % (id & 0x7FF)
        data = b"" if remote else frames[at + 8 : at + 8 + size].hex().upper().encode()
        lines += letter + number + b"%d" % size + data + b"\r"
    return lines


class Lines:
    """Cuts a stream into lines."""

    def __init__(self) -> None:
        self.rest = b""

    def take(self, data: bytes) -> list[bytes]:
        """Whole lines, without their ends; a bell stands by itself and is passed over."""
        *whole, self.rest = (self.rest + data).replace(b"\x07", b"\r").split(b"\r")
        return whole
