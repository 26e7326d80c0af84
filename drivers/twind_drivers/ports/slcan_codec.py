"""Codec of slcan: frames to lines and lines to frames, all of a cycle at once. Pure.

A line ends with CR: `t` iii l dd.., `T` iiiiiiii l dd.. (29 bit), `r`/`R` remote. BEL alone: the adapter
refused a command; CR alone, `z`, `Z`: it accepted it. There is no checksum, so a line is a frame only where
letter, digits, DLC and length agree to the last character.
"""

import numpy as np
from numpy.typing import NDArray

from twind_drivers.ports.frame import (
    ERROR,
    EXTENDED,
    EXTENDED_MASK,
    FRAME,
    NOTHING,
    REMOTE,
    STANDARD_MASK,
    Frames,
    Octets,
)

CR = 0x0D
BEL = 0x07
LONGEST = 26  # characters of a line, its end not counted: T, 8 of the id, DLC, 16 of the data
PATIENCE = 64  # characters without an end after which this is no line
WIDTH = LONGEST + 1
ACKNOWLEDGED = frozenset((b"", b"z", b"Z"))
REPORTS = frozenset(b"VvN")  # replies to requests of another program: version, serial number


def _pairs() -> NDArray[np.uint16]:
    """The two digits of each byte, as they lie in memory."""
    return np.frombuffer(bytes(range(256)).hex().upper().encode(), np.uint16)


def _values() -> Octets:
    """The value of each character as a digit; 255: it is none."""
    values = np.full(256, 255, np.uint8)
    for digits in (b"0123456789ABCDEF", b"0123456789abcdef"):
        values[np.frombuffer(digits, np.uint8)] = range(16)
    return values


def _columns() -> NDArray[np.bool_]:
    """Return the columns of a line (of WIDTH) that are sent, by 17 * extended + characters of data."""
    columns = np.ones((34, WIDTH), np.bool_)
    for extended in (0, 1):
        for size in range(17):
            columns[17 * extended + size, 1 : 1 if extended else 6] = False
            columns[17 * extended + size, 10 + size : 26] = False
    return columns


PAIRS = _pairs()
VALUES = _values()
COLUMNS = _columns()
LETTERS = np.frombuffer(b"tTrR", np.uint8)  # by 2 * remote + extended
KINDS = np.full(256, 255, np.uint8)
KINDS[LETTERS] = range(4)
ENDS = np.zeros(256, np.bool_)
ENDS[[CR, BEL]] = True
PLACES = np.arange(LONGEST)
WEIGHTS = np.uint32(1) << np.arange(28, -4, -4, dtype=np.uint32)  # of the eight digits of an id
# A line of eight data bytes, its letter left out or read as a leading 0: whole bytes, id and DLC in front.
STANDARD_ROW = np.dtype([("head", ">u2"), ("data", "u1", (8,))])
EXTENDED_ROW = np.dtype([("top", "u1"), ("head", ">u4"), ("data", "u1", (8,))])
TO_ZERO = bytes.maketrans(b"T", b"0")


def encode(frames: Frames) -> bytes:
    """The lines of all frames (k,), in their order. Raises ValueError for what is no frame."""
    if not len(frames):
        return b""
    if (frames["size"] == 8).all() and (frames["id"] <= STANDARD_MASK).all():
        return _standard(frames)
    flagged = np.ascontiguousarray(frames["id"])
    size = frames["size"]
    extended = flagged >> 31
    remote = flagged >> 30 & 1
    ids = flagged & EXTENDED_MASK
    wrong = (flagged & ERROR != 0) | (size > 8) | (ids > np.where(extended, EXTENDED_MASK, STANDARD_MASK))
    if wrong.any():
        place = int(np.argmax(wrong))
        raise ValueError(
            f"frame {place}: id {int(flagged[place]):08X} with {int(size[place])} bytes cannot be sent: "
            "at most 8 bytes, an id of 11 bits or of 29 with its flag, and no error frame"
        )
    lines = np.empty((len(frames), WIDTH), np.uint8)
    lines[:, 0] = LETTERS[2 * remote + extended]
    lines[:, 1:9] = PAIRS[ids.astype(">u4").view(np.uint8)].view(np.uint8).reshape(-1, 8)
    lines[:, 9] = size + ord("0")
    lines[:, 10:26] = PAIRS[frames["data"]].view(np.uint8)
    lines[:, 26] = CR
    sent: Octets = lines[COLUMNS[17 * extended + np.where(remote, 0, 2 * size)]]
    return sent.tobytes()


def _standard(frames: Frames) -> bytes:
    """Standard frames of 8 bytes, as a cycle's commands are."""
    rows = np.empty(len(frames), STANDARD_ROW)
    rows["head"] = frames["id"] << 4 | 8
    rows["data"] = frames["data"]
    lines = np.empty((len(frames), 22), np.uint8)
    lines[:, 0] = LETTERS[0]
    lines[:, 21] = CR
    digits = rows.tobytes().hex().upper().encode("ascii")
    lines[:, 1:21] = np.frombuffer(digits, np.uint8).reshape(-1, 20)
    return lines.tobytes()


class SlcanDecoder:
    """Decoder of the byte stream of an adapter. Holds at most PATIENCE bytes; nothing raises.

    The counters only rise: `errors` unknown lines, `refused` BELs, `acknowledged`. `flags`: the last reported
    status byte, -1 where none has arrived since it was set so.
    """

    def __init__(self) -> None:
        self.errors = self.refused = self.acknowledged = 0
        self.flags = -1
        self._rest = b""  # a line that has not ended yet
        self._lost = False  # it was too long: what comes up to the next end belongs to it

    @property
    def pending_size(self) -> int:
        """Bytes kept for the next call."""
        return len(self._rest)

    def forget(self) -> None:
        """Discard the incomplete line, which belongs to an earlier opening of the adapter."""
        self._rest = b""
        self._lost = False

    def take(self, data: bytes | memoryview) -> Frames:
        """The frames (k,) whose lines have ended now, in their order."""
        text = self._rest + data if self._rest else bytes(data)
        if not self._lost:
            self._rest = b""
            alike = _alike(text)
            if alike is None:
                alike = self._among_acknowledgements(text)
            if alike is not None:
                return alike
        octets = np.frombuffer(text, np.uint8)
        ends = np.flatnonzero(ENDS[octets])
        last = int(ends[-1]) + 1 if len(ends) else 0
        self._rest = text[last:]
        if len(ends):
            begins = np.empty_like(ends)
            begins[0] = 0
            begins[1:] = ends[:-1] + 1
            if self._lost:
                self._lost = False
                begins[0] = ends[0]
            frames = self._split(text, octets, begins, ends)
        else:
            frames = NOTHING
        if len(self._rest) > PATIENCE:
            self.errors += not self._lost
            self._rest = b""
            self._lost = True
        elif self._lost:
            self._rest = b""
        return frames

    def _among_acknowledgements(self, text: bytes) -> Frames | None:
        """Return frames of one kind with acknowledgements between, and a partial line; None otherwise."""
        whole, end, rest = text.rpartition(b"\r")
        if not end or BEL in text or len(rest) > PATIENCE:
            return None
        lines = whole.split(b"\r")
        framed = [line for line in lines if line not in ACKNOWLEDGED]
        found = _alike(b"\r".join(framed) + b"\r") if framed else NOTHING
        if found is not None:
            self.acknowledged += len(lines) - len(framed)
            self._rest = rest
        return found

    def _split(self, text: bytes, octets: Octets, begins: NDArray[np.intp], ends: NDArray[np.intp]) -> Frames:
        refused = octets[ends] == BEL
        kinds = KINDS[octets[begins]]
        framed = (kinds < 4) & ~refused
        if not framed.all():
            self._hear(text, begins[~framed], ends[~framed], refused[~framed])
            begins = begins[framed]
            ends = ends[framed]
            kinds = kinds[framed]
            if not len(begins):
                return NOTHING
        frames, sound = _frames(octets, begins, ends - begins, kinds)
        if not sound.all():
            self.errors += int(np.count_nonzero(~sound))
            frames = frames[sound]
        return frames

    def _hear(
        self, text: bytes, begins: NDArray[np.intp], ends: NDArray[np.intp], refused: NDArray[np.bool_]
    ) -> None:
        """Process lines that are no frames."""
        for begin, end, refusal in zip(begins.tolist(), ends.tolist(), refused.tolist(), strict=True):
            line = text[begin:end]
            if refusal:
                self.refused += 1
                self.errors += bool(line)
            elif line in ACKNOWLEDGED:
                self.acknowledged += 1
            elif line[0] == ord("F") and len(line) == 3 and (VALUES[list(line[1:])] < 16).all():
                self.flags = int(line[1:], 16)
            elif line[0] not in REPORTS:
                self.errors += 1


def _alike(text: bytes) -> Frames | None:
    """Lines that are all frames of 8 bytes of one kind, as a cycle's answers are; None: they are not."""
    extended = text[:1] == b"T"
    width = WIDTH if extended else 22
    count, rest = divmod(len(text), width)
    begin = b"T" if extended else b"t"
    if rest or not count or text[width - 1 :: width] != b"\r" * count or text[::width] != begin * count:
        return None
    # What is a letter, an end or a space at another place leaves too few digits, or too many letters.
    if text.count(b"T") != (count if extended else 0):
        return None
    try:
        packed = bytes.fromhex(text.translate(TO_ZERO, b"t\r").decode("ascii"))
    except ValueError:
        return None
    row = EXTENDED_ROW if extended else STANDARD_ROW
    if len(packed) != row.itemsize * count:
        return None
    rows = np.frombuffer(packed, row)
    head = rows["head"]
    ids: NDArray[np.uint32] = (head >> 4).astype(np.uint32)
    most = STANDARD_MASK
    if extended:
        ids |= rows["top"].astype(np.uint32) << 28
        most = EXTENDED_MASK
    if (head & 0xF != 8).any() or (ids > most).any():
        return None
    frames = np.zeros(count, FRAME)
    frames["id"] = ids | np.uint32(EXTENDED) if extended else ids
    frames["size"] = 8
    frames["data"] = rows["data"]
    return frames


def _frames(
    octets: Octets, begins: NDArray[np.intp], lengths: NDArray[np.intp], kinds: Octets
) -> tuple[Frames, NDArray[np.bool_]]:
    """Lines of the four letters as frames (k,), and which of them are sound (k,)."""
    at = begins[:, None] + PLACES
    digits = VALUES[octets.take(at, mode="clip")]
    extended = (kinds & 1).astype(np.bool_)
    head = np.where(extended, 10, 5)
    # Letter and id of a standard line go five to the right: then all have the columns of an extended one.
    if not extended.all():
        short = ~extended
        moved = np.zeros((int(np.count_nonzero(short)), LONGEST), np.uint8)
        moved[:, 6:] = digits[short, 1:21]
        digits[short] = moved
    size = digits[:, 9]
    carried = np.where(kinds < 2, size, 0).astype(np.intp)
    inside = PLACES[1:] < (10 + 2 * carried)[:, None]
    sound = (size <= 8) & (lengths == head + 2 * carried)
    sound &= ((digits[:, 1:] < 16) | ~inside).all(axis=1)
    frames = np.zeros(len(begins), FRAME)
    pairs = digits[:, 10::2] << 4 | digits[:, 11::2]
    frames["data"] = np.where(inside[:, 9::2], pairs, 0)
    number = digits[:, 1:9].astype(np.uint32) @ WEIGHTS
    sound &= number <= np.where(extended, EXTENDED_MASK, STANDARD_MASK)
    number |= np.where(extended, np.uint32(EXTENDED), np.uint32(0))
    number |= np.where(kinds >= 2, np.uint32(REMOTE), np.uint32(0))
    frames["id"] = number
    frames["size"] = size
    return frames, sound
