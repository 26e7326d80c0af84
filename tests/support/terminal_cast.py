"""A terminal recorded: a real shell on a pseudo-terminal, what it shows and when, as an asciicast v2."""

import fcntl
import json
import os
import pty
import re
import select
import signal
import struct
import termios
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

PROMPT = "$ "
TYPING = 0.03  # s a key
COLUMNS = 110
ROWS = 34
_MOVES = re.compile(r"\x1b\[(\d*)([AKJhlm])|\x1b\[\?\d+[hl]|\r|\n|[^\x1b\r\n]+|\x1b")


class Terminal:
    """A shell, and everything it has shown since `since` (s)."""

    def __init__(self, environment: Mapping[str, str], folder: Path) -> None:
        self.events: list[tuple[float, str]] = []
        self._begun = time.monotonic()
        self._pid, self._fd = pty.fork()
        if self._pid == 0:
            os.chdir(folder)
            shell = {**environment, "PS1": PROMPT, "TERM": "xterm-256color", "HISTFILE": ""}
            os.execvpe("bash", ["bash", "--norc", "--noprofile", "--noediting"], shell)
        os.set_inheritable(self._fd, False)  # forkpty(3) leaves it open for the next child
        fcntl.ioctl(self._fd, termios.TIOCSWINSZ, struct.pack("HHHH", ROWS, COLUMNS, 0, 0))
        self.until(PROMPT)

    def until(self, text: str, seconds: float = 60.0) -> None:
        """Until it has shown this, last of all."""
        deadline = time.monotonic() + seconds
        shown = ""
        while not shown.endswith(text):
            if time.monotonic() > deadline:
                raise AssertionError(f"{text!r} not within {seconds} s of {shown!r}")
            shown += self._read(0.1)

    def _read(self, seconds: float) -> str:
        ready, _, _ = select.select([self._fd], [], [], seconds)
        if not ready:
            return ""
        data = os.read(self._fd, 1 << 16)
        while True:  # a character may come in two pieces
            try:
                text = data.decode()
                break
            except UnicodeDecodeError:
                data += os.read(self._fd, 1)
        self.events.append((time.monotonic() - self._begun, text))
        return text

    def type(self, text: str) -> None:
        """Key by key, and ENTER; a pause before, as a reader needs it."""
        time.sleep(0.6)
        for key in text:
            os.write(self._fd, key.encode())
            self._read(TYPING)
            time.sleep(TYPING)
        os.write(self._fd, b"\n")

    def run(self, command: str, seconds: float = 60.0) -> None:
        """A command, until the next prompt."""
        self.type(command)
        self.until(f"\n{PROMPT}", seconds)

    def close(self) -> None:
        """The shell ends."""
        os.close(self._fd)
        os.kill(self._pid, signal.SIGHUP)
        os.waitpid(self._pid, 0)


def save(path: Path, events: Sequence[tuple[float, str]], title: str) -> None:
    """An asciicast v2: a line of what the terminal is, then a line an event."""
    head = {"version": 2, "width": COLUMNS, "height": ROWS, "title": title, "env": {"TERM": "xterm-256color"}}
    lines = [json.dumps(head), *(json.dumps([round(at, 3), "o", text]) for at, text in events)]
    path.write_text("\n".join(lines) + "\n")


def load(path: Path) -> str:
    """Everything that a recording shows. Raises ValueError: it is no asciicast v2."""
    head, *events = [json.loads(line) for line in path.read_text().splitlines()]
    times = [at for at, kind, _ in events if kind == "o"]
    if head["version"] != 2 or times != sorted(times) or len(times) != len(events):
        raise ValueError(f"{path}: no asciicast v2 of one terminal")
    return "".join(text for _, _, text in events)


def rendered(shown: str) -> list[str]:
    """Text left on an endless terminal once all was shown: lines that were drawn over are gone."""
    lines = [""]
    row = 0
    column = 0
    for found in _MOVES.finditer(shown):
        text = found[0]
        count = int(found[1] or 1)
        what = found[2]
        if text == "\r":
            column = 0
        elif text == "\n":
            row += 1
            lines += [""] * (row + 1 - len(lines))
        elif what == "A":
            row = max(0, row - count)
        elif what == "K":
            lines[row] = lines[row][:column]
        elif what == "J":
            lines[row:] = [lines[row][:column]]
        elif not text.startswith("\x1b"):
            lines[row] = lines[row][:column].ljust(column) + text + lines[row][column + len(text) :]
            column += len(text)
    return [line.rstrip() for line in lines]


def shortened(lines: Sequence[str], most: int) -> list[str]:
    """The same where a command says more than `most` lines: its first and its last ones."""
    kept: list[str] = []
    said: list[str] = []
    for line in [*lines, PROMPT]:
        if not line.startswith(PROMPT.strip()):
            said.append(line)
            continue
        if len(said) > most:
            half = most // 2
            said = [*said[:half], f"... {len(said) - 2 * half} more lines", *said[-half:]]
        kept += [*said, line]
        said = []
    return kept[:-1]
