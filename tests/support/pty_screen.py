"""A terminal for tests: a program on a pseudo-terminal of a size, and what stands on its screen now.

Knows the few escapes that the monitor writes, and no others: what else comes is garbage, and fails.
"""

import fcntl
import os
import pty
import re
import select
import signal
import struct
import termios
import time
from collections.abc import Callable, Sequence

_PIECE = re.compile(r"\x1b\[(\?)?([\d;]*)([A-Za-z])|\r|\n|[^\x1b\r\n]+")


class Screen:
    """Cells of a terminal without wrapping, its private modes, and how often it was emptied."""

    def __init__(self, columns: int, rows: int) -> None:
        self.modes: dict[str, bool] = {}
        self.resize(columns, rows)
        self._row = self._column = self.emptied = 0
        self._rest = ""

    def resize(self, columns: int, rows: int) -> None:
        """A window drawn larger or smaller: what was shown is cut, as terminals do."""
        before = getattr(self, "_cells", [])
        self.columns = columns
        self.rows = rows
        self._cells = [
            [*(before[row][:columns] if row < len(before) else []), *[" "] * columns][:columns]
            for row in range(rows)
        ]

    def show(self, text: str) -> None:
        """Show the output of a program."""
        text = self._rest + text
        self._rest = ""
        begun = text.rfind("\x1b")
        if begun >= 0 and not re.match(r"\x1b\[\??[\d;]*[A-Za-z]", text[begun:]):
            self._rest = text[begun:]
            text = text[:begun]
        at = 0
        while at < len(text):
            found = _PIECE.match(text, at)
            assert found, f"garbage: {text[at : at + 20]!r}"
            at = found.end()
            if found[3]:
                self._escape(found[1] or "", found[2], found[3])
            elif found[0] == "\r":
                self._column = 0
            elif found[0] == "\n":
                self._row += 1
            else:
                self._print(found[0])

    def _print(self, text: str) -> None:
        for character in text:
            assert character.isprintable(), f"garbage: {character!r}"
            if self._row < self.rows:
                self._cells[self._row][min(self._column, self.columns - 1)] = character
            self._column += 1

    def _escape(self, private: str, numbers: str, kind: str) -> None:
        if private:
            assert kind in "hl", f"garbage: ?{numbers}{kind}"
            self.modes[numbers] = kind == "h"
        elif kind == "H":
            row, column = (int(each) for each in (numbers or "1;1").split(";"))
            self._row = row - 1
            self._column = column - 1
        elif kind == "J" and numbers == "2":
            self.emptied += 1
            self._cells = [[" "] * self.columns for _ in range(self.rows)]
        elif kind == "K":
            if self._row < self.rows:
                self._cells[self._row][self._column :] = [" "] * max(0, self.columns - self._column)
        else:
            assert kind == "m", f"garbage: {numbers}{kind}"

    @property
    def lines(self) -> list[str]:
        """Lines of the screen."""
        return ["".join(row).rstrip() for row in self._cells]


class Run:
    """A program on a terminal of its own."""

    def __init__(self, command: Sequence[str], columns: int, rows: int, **environment: str) -> None:
        self.screen = Screen(columns, rows)
        self.raw = b""
        self.pid, self.fd = pty.fork()
        if self.pid == 0:
            fcntl.ioctl(0, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))
            os.execve(command[0], list(command), {**os.environ, "TERM": "xterm-256color", **environment})
        os.set_inheritable(self.fd, False)  # forkpty(3) leaves it open for the next child
        self.attributes = termios.tcgetattr(self.fd)
        self.ended: int | None = None

    def resize(self, columns: int, rows: int) -> None:
        """The window changes; the program is told by SIGWINCH."""
        self.screen.resize(columns, rows)
        fcntl.ioctl(self.fd, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))

    def type(self, keys: str) -> None:
        """Keys, as somebody presses them."""
        os.write(self.fd, keys.encode())

    def until(self, wanted: Callable[[Screen], object], seconds: float = 15.0) -> None:
        """Until the screen is as wanted."""
        end = time.monotonic() + seconds
        while not wanted(self.screen):
            shown = "\n".join(self.screen.lines)
            assert time.monotonic() < end and self.read(0.05), f"not within {seconds} s:\n{shown}"

    def read(self, seconds: float) -> bool:
        """Take what comes within that time; False: the program has let go of its terminal."""
        ready, _, _ = select.select([self.fd], [], [], seconds)
        if not ready:
            return True
        try:
            data = os.read(self.fd, 1 << 16)
        except OSError:
            return False
        self.raw += data
        while True:  # a character may come in two pieces
            try:
                text = data.decode()
                break
            except UnicodeDecodeError:
                data += os.read(self.fd, 1)
        self.screen.show(text)
        return bool(data)

    def watch(self, seconds: float) -> None:
        """Take what comes for so long."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.read(0.05)

    def end(self, number: int | None = None, seconds: float = 10.0) -> int:
        """Its exit status, after a signal if one is named; what it says on its way out is shown too."""
        if number is not None:
            os.kill(self.pid, number)
        end = time.monotonic() + seconds
        while time.monotonic() < end and self.ended is None:
            self.read(0.02)
            gone, status = os.waitpid(self.pid, os.WNOHANG)
            if gone:
                self.ended = os.waitstatus_to_exitcode(status)
        end = time.monotonic() + 1.0  # what it wrote may still be on its way
        while self.read(0.05) and time.monotonic() < end:
            pass
        assert self.ended is not None, "\n".join(self.screen.lines)
        return self.ended

    def close(self) -> None:
        """Whatever it does."""
        if self.ended is None:
            os.kill(self.pid, signal.SIGKILL)
            os.waitpid(self.pid, 0)
        os.close(self.fd)
