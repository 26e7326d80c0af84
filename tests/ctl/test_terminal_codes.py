"""Bytes of terminals as key events: legacy codes, the kitty protocol, sequences in pieces."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.ctl.teleoperating.terminal_codes import KeyEvent, TerminalAnswer, TerminalDecoder, TerminalKey

PRESSED = KeyEvent.PRESSED


@pytest.mark.parametrize(
    ("data", "events"),
    [
        (b"wW", [TerminalKey("w", PRESSED)] * 2),
        (b" \r\t\x7f", [TerminalKey(name, PRESSED) for name in ("space", "enter", "tab", "backspace")]),
        (b"\x1b[A\x1bOB", [TerminalKey("up", PRESSED), TerminalKey("down", PRESSED)]),
        (b"\x1b[5~", [TerminalKey("page_up", PRESSED)]),
        ("ä".encode(), [TerminalKey("ä", PRESSED)]),
        (b"\x1b[119u", [TerminalKey("w", PRESSED)]),
        (b"\x1b[119:87:119;2:2u", [TerminalKey("w", KeyEvent.REPEATED)]),
        (b"\x1b[119;1:3u\x1b[1;1:3A", [TerminalKey(name, KeyEvent.RELEASED) for name in ("w", "up")]),
        (b"\x1b[119;5u\x1b[119;5:3u", [TerminalKey("w", KeyEvent.RELEASED)]),  # with Ctrl: only its release
        (b"\x1b[99;5u", [TerminalAnswer.INTERRUPT]),
        (b"\x1b[57441;1:1u", []),  # the shift key alone
        (b"\x1b[0n\x1b[?11u\x1b[?62;4c\x1b[O\x1b[I", list(TerminalAnswer)[:4]),
        (b"\x1bw\x1b\x1b[B\x01", [TerminalKey("down", PRESSED)]),  # Alt, Escape, a control character
        (b"\x1b[200~", []),
    ],
)
def test_bytes_of_a_terminal_are_events(data: bytes, events: list[object]) -> None:
    assert list(TerminalDecoder().decode(data)) == events


@pytest.mark.parametrize("cut", range(1, 9))
def test_a_sequence_may_come_in_pieces(cut: int) -> None:
    decoder = TerminalDecoder()
    data = b"\x1b[119;1:3uw"
    assert [*decoder.decode(data[:cut]), *decoder.decode(data[cut:])] == [
        TerminalKey("w", KeyEvent.RELEASED),
        TerminalKey("w", PRESSED),
    ]


@given(st.lists(st.binary(max_size=40), max_size=10))
def test_any_bytes_are_taken(pieces: list[bytes]) -> None:
    decoder = TerminalDecoder()
    for piece in pieces:
        list(decoder.decode(piece))
    assert list(decoder.decode(b"\x1b[0n"))[-1:] != [None]
