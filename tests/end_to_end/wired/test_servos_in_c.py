"""The servos in C: they answer as an XM430 does, in the time that a wire takes."""

import os
import select
import shutil
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from bench.c_servos import ServoSettings, serving
from bench.compiled import compiled
from twind_drivers.dynamixel import packet

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler (`cc`)")
ROWS = "1 2048 neck 9:1=0 48:4=3000 52:4=1000\n2 1024 elbow 9:1=0\n"
PRESENT, GOAL, TORQUE, WATCHDOG = 132, 116, 64, 98
BAUD = 1_000_000


class Line:
    """Host side of the pseudo-terminal."""

    def __init__(self, path: str) -> None:
        self.fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self.fd)

    def ask(self, request: bytes, size: int) -> bytes:
        """Send a request and return at most `size` bytes of its reply; fewer after 0.5 s of silence."""
        os.write(self.fd, request)
        data = b""
        while len(data) < size and select.select([self.fd], [], [], 0.5)[0]:
            data += os.read(self.fd, size - len(data))
        return data

    def number(self, id: int, address: int) -> int:
        """Four bytes of one servo."""
        return int.from_bytes(self.ask(packet.read(id, address, 4), 15)[9:13], "little", signed=True)

    def put(self, id: int, address: int, value: int, size: int = 1) -> int:
        """Write a register; the error number."""
        return self.ask(packet.write(id, address, value.to_bytes(size, "little")), 11)[8]


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compiled("servos", tmp_path_factory.mktemp("native"))


@contextmanager
def served(program: Path, folder: Path, baud: int) -> Iterator[Line]:
    rows = folder / "rows"
    rows.write_text(ROWS)
    with serving(program, rows, baud, ServoSettings()) as path:
        line = Line(path)
        yield line
        os.close(line.fd)


@pytest.fixture
def line(program: Path, tmp_path: Path) -> Iterator[Line]:
    with served(program, tmp_path, 0) as made:
        yield made


def test_a_ping_is_answered_by_the_model_and_silence_by_others(line: Line) -> None:
    assert line.ask(packet.ping(1), 14)[9:12] == bytes.fromhex("FC 03 2E")
    assert line.ask(packet.ping(7), 14) == b""


def test_sync_and_fast_reads_carry_the_start_positions(line: Line) -> None:
    plain = line.ask(packet.sync_read((1, 2), PRESENT, 4), 30)
    assert [int.from_bytes(plain[at : at + 4], "little") for at in (9, 24)] == [2048, 1024]
    fast = line.ask(packet.fast_sync_read((1, 2), PRESENT, 4), 24)
    assert [int.from_bytes(fast[at : at + 4], "little") for at in (10, 18)] == [2048, 1024]


def test_a_goal_moves_under_torque_only_and_its_limits_hold(line: Line) -> None:
    assert line.put(1, GOAL, 2500, 4) == 0
    time.sleep(0.1)
    assert line.number(1, PRESENT) == 2048
    assert line.put(1, TORQUE, 1) == 0
    time.sleep(1.0)
    assert line.number(1, PRESENT) == 2500
    assert line.put(1, GOAL, 3001, 4) == 6
    assert line.put(1, 11, 4) == 7  # EEPROM under torque


def test_the_watchdog_expires_and_refuses_goals_until_it_is_cleared(line: Line) -> None:
    line.put(1, TORQUE, 1)
    assert line.put(1, WATCHDOG, 5) == 0
    time.sleep(0.2)
    assert line.number(1, WATCHDOG) & 0xFF == 255
    assert line.put(1, GOAL, 2100, 4) == 4
    assert line.put(1, WATCHDOG, 0) == 0
    assert line.put(1, GOAL, 2100, 4) == 0


def test_a_reply_takes_the_time_of_the_wire(program: Path, tmp_path: Path) -> None:
    with served(program, tmp_path, 57_600) as line:
        before = time.monotonic()
        assert len(line.ask(packet.sync_read((1, 2), PRESENT, 10), 42)) == 42
        assert time.monotonic() - before >= (42 + 16) * 10 / 57_600
