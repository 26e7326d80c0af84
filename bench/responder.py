"""Servos for the bus figures: `python -m bench.responder …`, a process of its own behind a pseudo-terminal.

Prints the port's path. Answers ping, reads and group reads with made-up readings; obeys nothing. Either at
once, so that only the host's CPU is left to measure, or paced like a wire behind a USB adapter. Answers are
kept by their request, so the cycle of a figure costs it a dictionary look-up.
"""

import argparse
import os
import pty
import sys
import termios
import time
import tty
from collections.abc import Iterator

from twind_drivers.dynamixel.packet import (
    BROADCAST,
    HEADER,
    Framer,
    Instruction,
    Packet,
    fast_status,
    status,
)

ROOM = 4096
READING = bytes.fromhex("10 00 20 00 00 00 00 08 00 00")  # current 16, velocity 32, position 2048
REGISTERS = bytes(126) + READING + bytes(ROOM)  # X series: Present Current is 126; all others are zero
MODEL = bytes.fromhex("FC 03 2F")  # XM430-W350, firmware 47
IDLE = 60.0  # s without a packet: whoever started us is gone


class ScriptedServos:
    """Answers by request. `silent`: an id that says nothing; a fast reply ends before it."""

    def __init__(self, silent: int) -> None:
        self._silent = silent
        self._known: dict[bytes, bytes] = {}
        self._framer = Framer(status=False)
        self._left = b""

    def parse_requests(self, data: bytes) -> Iterator[tuple[int, bytes]]:
        """(size, answer) of each whole packet in what has come so far."""
        data = self._left + data
        while len(data) >= 10 and data.startswith(HEADER):
            size = (data[5] | data[6] << 8) + 7
            if len(data) < size:
                break
            packet = data[:size]
            data = data[size:]
            yield size, self._answer(packet)
        self._left = data

    def _answer(self, packet: bytes) -> bytes:
        if packet[7] in (Instruction.SYNC_WRITE, Instruction.BULK_WRITE):
            return b""
        if packet not in self._known:
            self._known[packet] = b"".join(self._work_out(each) for each in self._framer.feed(packet))
        return self._known[packet]

    def _work_out(self, packet: Packet) -> bytes:
        params = packet.params
        if packet.instruction == Instruction.PING:
            return b"" if packet.id == self._silent else status(packet.id, 0, MODEL)
        address = int.from_bytes(params[:2], "little")
        size = int.from_bytes(params[2:4], "little")
        data = REGISTERS[address : address + size]
        ids = params[4:]
        if packet.instruction == Instruction.SYNC_READ:
            return b"".join(status(id, 0, data) for id in ids if id != self._silent)
        if packet.instruction == Instruction.FAST_SYNC_READ:
            end = ids.index(self._silent) if self._silent in ids else len(ids)
            rows = [(0, id, data) for id in ids[:end]]
            return b"".join(fast_status(rows, len(ids) * (size + 4) + 1)) if rows else b""
        if packet.instruction == Instruction.READ and packet.id != self._silent:
            return status(packet.id, 0, data)
        return b""


def at_once(master: int, servos: ScriptedServos) -> None:
    """Answer as soon as a packet is whole. Never sleeps: a host that must wake us would pay for it."""
    os.set_blocking(master, False)
    heard = time.perf_counter()
    while time.perf_counter() - heard < IDLE:
        try:
            data = os.read(master, ROOM)
        except BlockingIOError:
            continue
        heard = time.perf_counter()
        for _, answer in servos.parse_requests(data):
            if answer:
                os.write(master, answer)


def paced(master: int, servos: ScriptedServos, baud: int, tick: float) -> None:
    """10 bits a byte both ways; the adapter hands over what it has every `tick` s. Never sleeps."""
    os.set_blocking(master, False)
    byte = 10.0 / baud
    free = heard = time.perf_counter()
    start = 0.0
    out = b""
    given = 0
    next_tick = free
    while True:
        now = time.perf_counter()
        try:
            data = os.read(master, ROOM)
        except BlockingIOError:
            data = b""
        if data:
            heard = now
            for size, answer in servos.parse_requests(data):
                free = max(free, now) + size * byte
                if answer:
                    start = free
                    out = answer
                    given = 0
                    free += len(answer) * byte
        elif now - heard > IDLE:
            return
        if now >= next_tick:
            next_tick += tick * (1 + (now - next_tick) // tick)
            come = min(len(out), int((now - start) / byte)) if out else 0
            if come > given:
                os.write(master, out[given:come])
                given = come
            if given == len(out):
                out = b""


def main() -> int:
    """Serve until ended, or until nobody has asked for a minute."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--baud", type=int, default=0, help="0: answer at once")
    parser.add_argument("--tick", type=float, default=0.00025, help="s between two hand-overs of the adapter")
    parser.add_argument("--silent", type=int, default=BROADCAST, help="an id that does not answer")
    options = parser.parse_args()
    master, slave = pty.openpty()
    tty.setraw(slave, termios.TCSANOW)
    print(os.ttyname(slave), flush=True)
    servos = ScriptedServos(options.silent)
    try:
        if options.baud:
            paced(master, servos, options.baud, options.tick)
        else:
            at_once(master, servos)
    except (OSError, KeyboardInterrupt):
        return 0
    return 0


if __name__ == "__main__":
    sys.exit(main())
