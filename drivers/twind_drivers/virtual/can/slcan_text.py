"""Slcan text of a virtual adapter: lines of the host in, answers and frames out.

Commands and answers are those of the LAWICEL adapters: CR is yes, BEL is no, z and Z acknowledge a frame. The
answer to F is recalled from their manual (unverified): bit 2 warning, 5 passive, 7 bus error.
"""

from collections.abc import Sequence

import numpy as np

from twind_drivers.ports.frame import BYTES, ERROR, EXTENDED, EXTENDED_MASK, REMOTE, STANDARD_MASK
from twind_drivers.virtual.can.can_controller import VirtualHostController
from twind_drivers.virtual.can.can_message import CanMessage

YES = b"\r"
NO = b"\a"
LONGEST = 64  # characters of a line that the adapter keeps; a longer one is answered NO
RATES = (10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)  # S0..S8
HEX = frozenset(b"0123456789ABCDEFabcdef")
WARNING = 0x04
PASSIVE = 0x20
BUS_ERROR = 0x80
KINDS = ("truncated", "shifted", "joined", "letter", "high", "long", "short")


class SlcanText:
    """One adapter's text. Random, but the same for one seed."""

    def __init__(self, controller: VirtualHostController, seed: int) -> None:
        self._controller = controller
        self._line = bytearray()
        self._deaf = False  # the rest of a line that was too long
        self._spoilt = 0
        self._kind = ""
        self.restart(seed)

    def restart(self, seed: int) -> None:
        """The random numbers of this seed from their beginning."""
        self._random = np.random.default_rng(seed)

    def spoil(self, count: int, kind: str) -> None:
        """The next lines of frames are broken, each in this way or (empty) in any. Raises ValueError."""
        if count < 0 or (kind and kind not in KINDS):
            raise ValueError(f"corrupt: {count} lines, {kind!r}: 0 on, and one of {', '.join(KINDS)}")
        self._spoilt = count
        self._kind = kind

    def forget(self) -> None:
        """Discard a partial line."""
        self._line.clear()
        self._deaf = False

    def receive_text(self, data: bytes, now: float) -> bytes:
        """Bytes of the host at `now`, s; the adapter's answers."""
        answer = b""
        *lines, rest = data.split(b"\r")
        for line in lines:
            whole = bytes(self._line) + line
            deaf = self._deaf or len(whole) > LONGEST
            answer += NO if deaf else self._execute(whole, now)
            self.forget()
        self._line += rest
        if len(self._line) > LONGEST:
            self.forget()
            self._deaf = True
        return answer

    def print(self, frames: Sequence[CanMessage]) -> bytes:
        """Frames for the host; error frames have no text."""
        lines = [self._text(each) for each in frames if not each.id & ERROR]
        if self._spoilt:
            lines = [self._broken(line) for line in lines]
        return b"".join(lines)

    # ------------------------------------------------------------------------------------- the host's lines

    def _execute(self, line: bytes, now: float) -> bytes:
        controller = self._controller
        order = line[:1]
        if not line:
            return YES
        if order in (b"t", b"T", b"r", b"R"):
            message = parsed(line)
            if message is None or not controller.take(message, now):
                return NO
            if not controller.adapter.acknowledges:
                return b""
            return b"Z\r" if message.id & EXTENDED else b"z\r"
        if line in (b"O", b"L") and not controller.up:
            controller.connect(True, listens_only=line == b"L")
            return YES
        if line == b"C" and controller.up:
            controller.connect(False)
            return YES
        if order == b"S" and not controller.up and len(line) == 2 and line[1:] in b"012345678":
            controller.rate = RATES[int(line[1:])]
            return YES
        return self._send_line(line)

    def _send_line(self, line: bytes) -> bytes:
        if line == b"F" and self._controller.up:
            return b"F%02X\r" % self._flags()
        return {b"V": b"V1013\r", b"N": b"NTWVC\r"}.get(line, NO)

    def _flags(self) -> int:
        controller = self._controller
        alone = controller.backlog() > 0 and not controller.may_send()
        if controller.off or (alone and not controller.stalled):
            return WARNING | PASSIVE | BUS_ERROR
        return WARNING | PASSIVE if controller.passive else 0

    # ------------------------------------------------------------------------------------- to the host

    def _text(self, message: CanMessage) -> bytes:
        id, data = message
        letter = ("R" if id & REMOTE else "T") if id & EXTENDED else ("r" if id & REMOTE else "t")
        shown = f"{id & EXTENDED_MASK:08X}" if id & EXTENDED else f"{id & STANDARD_MASK:03X}"
        return f"{letter}{shown}{len(data)}{'' if id & REMOTE else data.hex().upper()}\r".encode()

    def _broken(self, line: bytes) -> bytes:
        if not self._spoilt:
            return line
        self._spoilt -= 1
        kind = self._kind or KINDS[int(self._random.integers(len(KINDS)))]
        body = line[:-1]
        at = int(self._random.integers(1, len(line) - 1))
        if kind == "truncated":
            return body[:at] + b"\r"
        if kind == "shifted":
            return body[:at] + body[at - 1 : at] + body[at:] + b"\r"
        if kind == "joined":
            return body
        if kind == "letter":
            return body[:at] + b"G" + body[at + 1 :] + b"\r"
        if kind == "high":
            return body[:at] + bytes([body[at] | 0x80]) + body[at + 1 :] + b"\r"
        size = 9 if line[:1] in (b"T", b"R") else 4
        if kind == "long":
            return body[:size] + b"9" + body[size + 1 :].ljust(18, b"0") + b"\r"
        return body[:-2] + b"\r"


def parsed(line: bytes) -> CanMessage | None:
    """The frame of one line without its CR; None: it is none."""
    extended = line[:1] in b"TR"
    remote = line[:1] in b"rR"
    digits = 8 if extended else 3
    head = line[1 : 1 + digits]
    rest = line[2 + digits :]
    if len(line) < 2 + digits or not HEX.issuperset(line[1:]):
        return None
    size = int(line[1 + digits : 2 + digits], 16)
    id = int(head, 16)
    if size > BYTES or id > (EXTENDED_MASK if extended else STANDARD_MASK):
        return None
    if len(rest) != (0 if remote else 2 * size):
        return None
    flags = (EXTENDED if extended else 0) | (REMOTE if remote else 0)
    return CanMessage(id | flags, bytes(size) if remote else bytes.fromhex(rest.decode()))
