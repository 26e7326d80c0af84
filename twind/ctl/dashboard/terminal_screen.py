"""A terminal: a screen of its own, keys, size, and everything given back however the process ends."""

import contextlib
import os
import select
import signal
import sys
import termios
import tty
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import FrameType

# A screen of its own, no cursor, no wrapping at the edge (which a smaller window would turn into garbage).
_ENTER = "\x1b[?1049h\x1b[?25l\x1b[?7l\x1b[2J"
_LEAVE = "\x1b[?2026l\x1b[0m\x1b[?7h\x1b[?25h\x1b[?1049l"
# shown at once, where the terminal knows how
_BEGIN = "\x1b[?2026h"
_END = "\x1b[?2026l"
KEYS = {
    b"q": "quit",
    b"\x1b": "quit",
    b" ": "freeze",
    b"\t": "page",
    b"\x1b[A": "up",
    b"\x1b[B": "down",
    b"\x1b[5~": "up",
    b"\x1b[6~": "down",
    b"k": "up",
    b"j": "down",
}


class TerminalScreen:
    """Draws lines over what was there: only those that changed are written. Main thread only."""

    def __init__(self) -> None:
        self._before: list[str] = []
        self._size = (0, 0)
        self._awake, self._waker = os.pipe()  # signals arrive here, so that a wait ends at once
        for end in (self._awake, self._waker):
            os.set_blocking(end, False)
        self._keys = sys.stdin.fileno() if sys.stdin.isatty() else -1
        self._attributes = None if self._keys < 0 else termios.tcgetattr(self._keys)

    @contextmanager
    def entered(self) -> Iterator["TerminalScreen"]:
        """The terminal is ours; left as it was found."""
        kinds = (signal.SIGWINCH, signal.SIGTSTP)
        before = [signal.getsignal(kind) for kind in kinds]
        woken = signal.set_wakeup_fd(self._waker, warn_on_full_buffer=False)
        try:
            signal.signal(signal.SIGWINCH, lambda _number, _frame: None)
            signal.signal(signal.SIGTSTP, self._sleep)
            self._enter()
            yield self
        finally:
            signal.set_wakeup_fd(woken)
            for kind, handler in zip(kinds, before, strict=True):
                signal.signal(kind, handler)
            self._leave()
            os.close(self._awake)
            os.close(self._waker)

    def size(self) -> tuple[int, int]:
        """Columns and rows now."""
        try:
            columns, rows = os.get_terminal_size(sys.stdout.fileno())
        except OSError:
            columns = 0
            rows = 0
        return columns or 80, rows or 24

    def draw(self, lines: Sequence[str], size: tuple[int, int]) -> None:
        """These lines, made for this size; another one than before begins on an empty screen."""
        if size != self._size:
            self._size = size
            self._before = []
            parts = ["\x1b[2J"]
        else:
            parts = []
        gone = len(self._before) - len(lines)
        for row, text in enumerate([*lines, *[""] * max(0, gone)]):
            if row >= len(self._before) or self._before[row] != text:
                # Erased before: after a line of full width the cursor is on its last character.
                parts.append(f"\x1b[{row + 1};1H\x1b[K{text}")
        self._before = list(lines)
        if parts:
            self._write("".join([_BEGIN, *parts, _END]))

    def wait(self, seconds: float) -> list[str]:
        """Until then, a signal, or keys; what the keys mean."""
        sources = [self._awake, *([self._keys] if self._keys >= 0 else [])]
        ready, _, _ = select.select(sources, [], [], max(0.0, seconds))
        if self._awake in ready:
            os.read(self._awake, 512)
        if self._keys not in ready:
            return []
        try:
            data = os.read(self._keys, 64)
        except OSError:  # the terminal went away
            data = b""
        if not data:
            self._keys = -1
        return list(meant(data))

    def _enter(self) -> None:
        if self._keys >= 0:
            tty.setcbreak(self._keys, termios.TCSADRAIN)  # keys at once and unseen; Ctrl-C stays a signal
        self._size = (0, 0)
        self._write(_ENTER)

    def _leave(self) -> None:
        with contextlib.suppress(OSError, termios.error):  # the terminal is gone
            self._write(_LEAVE)
            if self._attributes is not None and self._keys >= 0:
                termios.tcsetattr(self._keys, termios.TCSADRAIN, self._attributes)

    def _sleep(self, _number: int, _frame: FrameType | None) -> None:
        """Ctrl-Z: the shell gets its terminal, and `fg` a whole new picture."""
        self._leave()
        os.kill(os.getpid(), signal.SIGSTOP)
        self._enter()

    @staticmethod
    def _write(text: str) -> None:
        # Unbuffered: output that a signal cut short must not be written again.
        data = memoryview(text.encode(sys.stdout.encoding or "utf-8", "replace"))
        while data:
            data = data[os.write(sys.stdout.fileno(), data) :]


def meant(data: bytes) -> Iterator[str]:
    """Actions of the keys in `data`; unknown keys have none."""
    while data:
        length = next((size for size in (4, 3, 1) if data[:size] in KEYS and len(data) >= size), 0)
        if length == 1 and data[:1] == b"\x1b" and len(data) > 1:
            data = b""  # a sequence that we do not know
        elif length:
            yield KEYS[data[:length]]
            data = data[length:]
        else:
            data = data[1:]


def is_live() -> bool:
    """Standard output is a terminal that can be drawn on."""
    return sys.stdout.isatty() and os.environ.get("TERM", "dumb") not in ("dumb", "unknown", "")
