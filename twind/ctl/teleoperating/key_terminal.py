"""A terminal as the keyboard of teleoperation: raw keys, with releases where it reports them."""

import contextlib
import os
import select
import termios
import time
import tty
from collections.abc import Mapping, Sequence

from twind.command_line.verb import UsageError
from twind.ctl.teleoperating import terminal_codes as codes
from twind.ctl.teleoperating.held_keys import HeldKeys
from twind.ctl.teleoperating.terminal_codes import KeyEvent, TerminalAnswer, TerminalDecoder, TerminalKey

PATIENCE = 2.0  # s for the first answer of the terminal, which may be far away
LAST = 0.3  # s for the answers that are under way at the end: they must not reach the shell


class KeyTerminal:
    """The controlling terminal, from `__init__` to `close`."""

    def __init__(self) -> None:
        """Raises UsageError: there is no terminal, or it does not answer."""
        try:
            self._fd = os.open("/dev/tty", os.O_RDWR | os.O_NOCTTY | os.O_CLOEXEC)
        except OSError as error:
            raise UsageError(f"no terminal for the keyboard ({error.strerror}): use --gamepad") from None
        self._usual = termios.tcgetattr(self._fd)
        self._decoder = TerminalDecoder()
        self._pressed: list[str] = []
        self._is_interrupted = False
        self.has_releases = False
        try:
            self._enter()
        except BaseException:
            self.close()
            raise
        self._keys = HeldKeys(releases=self.has_releases)

    def _enter(self) -> None:
        tty.setcbreak(self._fd)
        attributes = termios.tcgetattr(self._fd)
        attributes[6][termios.VSUSP] = b"\0"  # a stopped process would leave the terminal as it is now
        termios.tcsetattr(self._fd, termios.TCSANOW, attributes)
        self._write(codes.ASK_RELEASES)
        end = time.monotonic() + PATIENCE
        while True:
            if not select.select([self._fd], [], [], max(0.0, end - time.monotonic()))[0]:
                raise UsageError(
                    f"the terminal does not answer within {PATIENCE:g} s: use another one, or --gamepad"
                )
            events = list(self._decoder.decode(self._read()))
            self.has_releases |= TerminalAnswer.HAS_RELEASES in events
            if TerminalAnswer.IDENTITY in events:
                break
        self._write(codes.FOCUS_ON + (codes.RELEASES_ON if self.has_releases else b""))

    def close(self) -> None:
        """Give the terminal back as it was."""
        with contextlib.suppress(OSError, EOFError, termios.error):  # it is gone
            self._write(codes.FOCUS_OFF + (codes.RELEASES_OFF if self.has_releases else b""))
            self._take_last()
            termios.tcsetattr(self._fd, termios.TCSAFLUSH, self._usual)
        os.close(self._fd)

    def _take_last(self) -> None:
        keys = getattr(self, "_keys", None)
        end = time.monotonic() + LAST
        while keys is not None and not keys.is_answered:
            if not select.select([self._fd], [], [], max(0.0, end - time.monotonic()))[0]:
                return
            self._decode()

    # ------------------------------------------------------------------------------------- `TeleopInput`

    def take(self, now: float) -> None:
        """Read the keys that have come, and ask for the next proof. Raises EOFError, KeyboardInterrupt."""
        while select.select([self._fd], [], [], 0.0)[0]:
            self._decode()
        if self._is_interrupted:
            raise KeyboardInterrupt
        if self._write(codes.ASK_STATUS):
            self._keys.ask(now)

    def held(self, now: float) -> Mapping[str, float]:
        """Return the keys that are held."""
        return dict.fromkeys(self._keys.held(now), 1.0)

    def pressed(self) -> Sequence[str]:
        """Return the keys that were pressed since the last call."""
        pressed = self._pressed
        self._pressed = []
        return pressed

    def is_kept(self, control: str) -> bool:
        """Return True if a held key is not only tapped."""
        return self._keys.is_kept(control)

    # --------------------------------------------------------------------------------------------- bytes

    def _decode(self) -> None:
        for event in self._decoder.decode(self._read()):
            match event:
                case TerminalKey():
                    self._keys.take(event)
                    if event.event is KeyEvent.PRESSED:
                        self._pressed.append(event.name)
                case TerminalAnswer.STATUS:
                    self._keys.answer()
                case TerminalAnswer.FOCUS_LOST:
                    self._keys.drop_all()
                case TerminalAnswer.INTERRUPT:
                    self._is_interrupted = True

    def _read(self) -> bytes:
        try:
            data = os.read(self._fd, 4096)
        except OSError as error:
            raise EOFError(f"the terminal is gone: {error.strerror}") from None
        if not data:
            raise EOFError("the terminal is gone")
        return data

    def _write(self, data: bytes) -> bool:
        """Write; False: the terminal takes nothing now. Raises EOFError."""
        if not select.select([], [self._fd], [], 0.0)[1]:
            return False
        try:
            return os.write(self._fd, data) == len(data)
        except OSError as error:
            raise EOFError(f"the terminal is gone: {error.strerror}") from None
