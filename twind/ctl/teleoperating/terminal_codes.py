"""Bytes of a terminal as key events and answers. Pure.

Sources: ECMA-48 and xterm (control sequences), and the kitty keyboard protocol, whose sequences
`CSI code ; modifiers : event u` report releases.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum

ASK_RELEASES = b"\x1b[?u\x1b[c"  # flags of the kitty protocol; every terminal answers the second question
RELEASES_ON = b"\x1b[>11u"  # disambiguate, report event types, report all keys as escape codes
RELEASES_OFF = b"\x1b[<u"
FOCUS_ON = b"\x1b[?1004h"
FOCUS_OFF = b"\x1b[?1004l"
ASK_STATUS = b"\x1b[5n"
NAMED = {13: "enter", 10: "enter", 9: "tab", 127: "backspace", 8: "backspace", 32: "space"}
ARROWS = {"A": "up", "B": "down", "C": "right", "D": "left", "H": "home", "F": "end"}
TILDES = {2: "insert", 3: "delete", 5: "page_up", 6: "page_down"}
KEY_NAMES = tuple(dict.fromkeys([*NAMED.values(), *ARROWS.values(), *TILDES.values()]))
_CONTROL = 4
_OTHERS = 2 | _CONTROL | 8 | 16 | 32  # modifiers with which a key is no key of ours; shift and locks are none
_PIECE = re.compile(
    r"\x1b\[(?P<private>[<-?]*)(?P<numbers>[0-9:;]*)(?P<kind>[@-~])|\x1bO(?P<single>[@-~])|"
    r"\x1b[^\x1b\[O]|(?P<text>[^\x1b])|\x1b(?=\x1b)"
)
_BEGUN = re.compile(r"\x1b(\[[<-?]*[0-9:;]*|O)?\Z")


class KeyEvent(Enum):
    """Kind of a key event. A terminal without releases reports repeats as presses."""

    PRESSED = 1
    REPEATED = 2
    RELEASED = 3


@dataclass(frozen=True, slots=True)
class TerminalKey:
    """One event of a key, by its name."""

    name: str
    event: KeyEvent


class TerminalAnswer(Enum):
    """A report of the terminal that is no key."""

    STATUS = "status"  # it has processed `ASK_STATUS`
    HAS_RELEASES = "has releases"  # the answer to the first question of `ASK_RELEASES`
    IDENTITY = "identity"  # the answer to the second one
    FOCUS_LOST = "focus lost"
    INTERRUPT = "interrupt"  # Ctrl-C as a key


TerminalEvent = TerminalKey | TerminalAnswer


class TerminalDecoder:
    """Decodes a stream of bytes; a sequence may come in pieces."""

    def __init__(self) -> None:
        self._rest = b""

    def decode(self, data: bytes) -> Iterator[TerminalEvent]:
        """Yield the events that are complete now. What is not known is left out."""
        text, self._rest = _complete(self._rest + data)
        for found in _PIECE.finditer(text):
            event = _event(found)
            if event is not None:
                yield event


def _complete(data: bytes) -> tuple[str, bytes]:
    """Return the text of whole sequences and characters, and the bytes of one that has begun."""
    text = data.decode(errors="ignore")
    begun = _BEGUN.search(text)
    if begun is None or len(begun[0]) > 64:
        return text, b""
    return text[: begun.start()], begun[0].encode()


def _event(found: re.Match[str]) -> TerminalEvent | None:
    if found["text"]:
        return _pressed(_named(ord(found["text"])))
    if found["single"]:
        return _pressed(ARROWS.get(found["single"]))
    if not found["kind"]:
        return None  # a key with Alt, or Escape
    match found["private"], found["numbers"], found["kind"]:
        case "", "0", "n":
            return TerminalAnswer.STATUS
        case "?", _, "u":
            return TerminalAnswer.HAS_RELEASES
        case "?", _, "c":
            return TerminalAnswer.IDENTITY
        case "", "", "O":
            return TerminalAnswer.FOCUS_LOST
        case "", numbers, kind:
            return _key(numbers, kind)
    return None


def _key(numbers: str, kind: str) -> TerminalEvent | None:
    """A key as `CSI code ; modifiers : event kind`."""
    first, _, second = numbers.partition(";")
    code = int(first.partition(":")[0] or 1)
    modifiers, _, number = second.partition(";")[0].partition(":")
    held = int(modifiers or 1) - 1
    event = KeyEvent(int(number)) if number in ("1", "2", "3") else KeyEvent.PRESSED
    if kind == "u" and code == ord("c") and held & _CONTROL:
        return TerminalAnswer.INTERRUPT
    if kind == "u":
        name = _named(code)
    else:
        name = TILDES.get(code) if kind == "~" else ARROWS.get(kind)
    if name is None or (held & _OTHERS and event is not KeyEvent.RELEASED):
        return None
    return TerminalKey(name, event)


def _pressed(name: str | None) -> TerminalKey | None:
    return None if name is None else TerminalKey(name, KeyEvent.PRESSED)


def _named(code: int) -> str | None:
    """Name of a key by its character; None: a control character or a key of the protocol's private range."""
    if code in NAMED:
        return NAMED[code]
    if 0xE000 <= code <= 0xF8FF or code > 0x10FFFF or not chr(code).isprintable():
        return None
    return chr(code).lower()
