"""The monitor's own codec, against the manual's packets and the vendor's client; and whom it knows."""

import ast
import random
import sys
from pathlib import Path

import pytest
from dynamixel_sdk import COMM_SUCCESS, PacketHandler, PortHandler

from tests.proof import busmon
from tests.proof.busmon import crc, packet
from tests.proof.busmon.answers import Ear
from tests.proof.busmon.monitor import Monitor
from tests.proof.busmon.requests import Parser
from tests.proof.evil import world
from tests.proof.evil.good import Good

HOME = Path(busmon.__file__).parent
TEST_SIDE = {"started.py"}  # starts the robot and the daemon for tests: no part of the monitor
STARTS_OTHERS = {"importlib", "runpy", "subprocess", "multiprocessing", "ctypes"}
ALLOWED = (sys.stdlib_module_names - STARTS_OTHERS) | {"tests.proof.busmon", "numpy", "yaml"}
LIMITS = world.limits()
GOLDEN = {
    "FF FF FD 00 01 03 00 01 19 4E": (1, 0x01, ""),
    "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15": (1, 0x02, "84 00 04 00"),
    "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89": (1, 0x03, "74 00 00 02 00 00"),
    "FF FF FD 00 01 03 00 08 2F 4E": (1, 0x08, ""),
    "FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA": (254, 0x82, "84 00 04 00 01 02"),
    "FF FF FD 00 01 0A 00 03 74 00 FF FF FD FD 00 21 E7": (1, 0x03, "74 00 FF FF FD 00"),
    "FF FF FD 00 01 0A 00 03 74 00 FF FF FD FD FD 2C 65": (1, 0x03, "74 00 FF FF FD FD"),
    "FF FF FD 00 01 0D 00 03 66 00 FF FF FD FD FF FF FD FD 33 F8": (1, 0x03, "66 00 FF FF FD FF FF FD"),
}


# ------------------------------------------------------------------------------------------- whom it knows


def _top(module: str) -> str:
    """The package of a module, the whole path of one of the tests."""
    return ".".join(module.split(".")[: 3 if module.startswith("tests.") else 1])


def _imports(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {_top(name.name) for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            found.add("." if node.level else _top(node.module or ""))
        elif isinstance(node, ast.Call) and ast.unparse(node.func) in ("__import__", "import_module"):
            found.add(ast.unparse(node))
    return found


def test_the_monitor_imports_nothing_of_what_it_watches() -> None:
    files = [
        path
        for path in HOME.rglob("*.py")
        if not path.name.startswith("test_") and path.name not in TEST_SIDE
    ]
    assert len(files) >= 8
    for path in files:
        assert _imports(path) <= ALLOWED, path.name


# ------------------------------------------------------------------------------------------- codec


def test_the_crc_of_the_check_value_is_the_printed_one() -> None:
    assert crc.bitwise(b"123456789") == crc.crc16(b"123456789") == 0xFEE8


def test_the_tables_give_the_bitwise_crc() -> None:
    rng = random.Random(1)
    for length in (*range(40), 132, 342, 1023, 1024, 1025, 1300):
        data = rng.randbytes(length)
        assert crc.crc16(data) == crc.bitwise(data), length


def test_the_crc_is_the_vendors_on_packets_without_pattern() -> None:
    rng = random.Random(2)
    handler = PacketHandler(2.0)
    for _ in range(300):
        data = packet.HEADER + bytes(rng.choice(range(0xF0)) for _ in range(rng.randrange(4, 140)))
        assert crc.bitwise(data) == handler.updateCRC(0, list(data), len(data))


@pytest.mark.parametrize("text", GOLDEN)
def test_the_manuals_packets_are_opened_and_made(text: str) -> None:
    data = bytes.fromhex(text)
    id, instruction, params = GOLDEN[text]
    assert packet.size_of(data, 0) == len(data)
    assert packet.open_packet(data) == (id, instruction, bytes.fromhex(params))
    assert packet.make(id, instruction, bytes.fromhex(params)) == data


def test_stuffing_is_undone_for_every_short_run_of_its_own_bytes() -> None:
    values = (0xFF, 0xFD, 0x00, 0x55)
    for length in range(1, 7):
        for number in range(4**length):
            body = bytes([0x03, *(values[number >> 2 * place & 3] for place in range(length))])
            assert packet.unstuff(packet.stuff(body)) == body


def test_a_packet_of_the_vendor_client_is_decoded_with_its_status(monkeypatch: pytest.MonkeyPatch) -> None:
    """The vendor's client writes into our ear: one side's bytes, the other side's understanding."""
    sent: list[bytes] = []
    port = PortHandler("nowhere")
    monkeypatch.setattr(port, "writePort", lambda data: sent.append(bytes(data)) or len(data))
    monkeypatch.setattr(port, "clearPort", lambda: None)
    assert (
        PacketHandler(2.0).txPacket(port, [0, 0, 0, 0, 1, 9, 0, 3, 116, 0, 0, 8, 0, 0, 0, 0]) == COMM_SUCCESS
    )
    request = Parser(LIMITS).take(sent[0])
    assert request.rows == [(1, 116, bytes.fromhex("00 08 00 00"))]
    assert not request.wrong


def test_a_single_flipped_bit_makes_a_packet_malformed() -> None:
    for bit in range(0, 8 * 29, 5):
        data = bytearray(packet.make(254, 0x83, bytes.fromhex("74 00 04 00 01 34 08 00 00 02 fc 08 00 00")))
        data[bit // 8 % len(data)] ^= 1 << bit % 8
        monitor = Monitor(LIMITS)
        monitor.sent(bytes(data), 1.0)
        monitor.look(2.0)
        assert "W8" in {violation.rule for violation in monitor.violations}, bit


def test_packets_may_come_in_any_chunks() -> None:
    port = world.VirtualPort(LIMITS)
    chunks: list[tuple[bytes, float]] = []
    write = port.write
    port.write = lambda data: (chunks.append((data, port.now)), write(data))[1]  # type: ignore[method-assign]
    Good(port, LIMITS).connect()
    for size in (1, 2, 3, 7):
        monitor = Monitor(LIMITS)
        for data, now in chunks:
            for at in range(0, len(data), size):
                monitor.sent(data[at : at + size], now)
        assert monitor.sent_packets == port.monitor.sent_packets
        assert {violation.rule for violation in monitor.violations} <= {"W9"}  # no answers are given here


def test_a_malformed_packet_does_not_hide_the_next() -> None:
    monitor = Monitor(LIMITS)
    good = packet.make(1, 0x01)
    monitor.sent(b"\x12\x34" + good + b"\xff\xff\xfd" + good, 0.0)
    assert monitor.sent_packets == 2
    assert [violation.rule for violation in monitor.violations].count("W8") == 2


# ------------------------------------------------------------------------------------------- answers


def test_a_shortened_common_reply_is_accepted_up_to_its_last_valid_block() -> None:
    answer = bytes.fromhex(
        "FF FF FD 00 FE 19 00 55 00 03 A6 00 00 00 84 08 00 07 1F 08 00 00 16 CA 00 04 FF 03 00 00 D1 9E"
    )
    request = Parser(LIMITS).take(bytes.fromhex("FF FF FD 00 FE 0A 00 8A 84 00 04 00 03 07 04 20 F2"))
    for cut, told in ((len(answer), 3), (len(answer) - 1, 2), (24, 2), (23, 1), (16, 1), (15, 0)):
        ear = Ear()
        ear.ask(request, 0.0)
        assert len(list(ear.take(answer[:cut]))) == told, cut
    ear = Ear()
    ear.ask(request, 0.0)
    assert [row[0] for part in range(32) for row in ear.take(answer[part : part + 1])] == [3, 7, 4]


def test_noise_before_and_between_statuses_is_passed_over() -> None:
    request = Parser(LIMITS).take(packet.make(254, 0x82, bytes.fromhex("84 00 04 00 01 02")))
    one = packet.make(1, 0x55, b"\0\x34\x08\0\0")
    two = packet.make(2, 0x55, b"\x80\x35\x08\0\0")
    ear = Ear()
    ear.ask(request, 0.0)
    found = list(ear.take(b"\xff\xff\xfd\0\x12" + one[:-3] + one + b"\xff\xff" + two))
    assert [(row[0], row[1]) for row in found] == [(1, 0), (2, 0x80)]
    assert ear.done
