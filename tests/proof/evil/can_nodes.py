"""Four motors of four kinds on one CAN bus, as far as a daemon can tell: what all of them talk to.

Each goes where it is told at once. Frames are made and read from the vendors' tables, by hand.
"""

import struct
from dataclasses import dataclass, field

from tests.proof.busmon.can.motors import TURN, CanLimits, Motor, motor, word
from tests.proof.busmon.can.text import Frame, Lines, Malformed, frame

DELAY = 0.0004  # s from a frame to its answer
DAMIAO = 1
ROBSTRIDE = 2
ODRIVE = 3
CUBEMARS = 4
START = {DAMIAO: 0.20, ROBSTRIDE: -0.30, ODRIVE: 0.10, CUBEMARS: 0.05}  # rad
HOST = 0xFD


def limits() -> CanLimits:
    """As the monitor is told them."""
    spans = {DAMIAO: (12.5, 8.0, 28.0), ROBSTRIDE: (12.57, 33.0, 14.0), ODRIVE: (0.0, 200.0, 30.0)}
    spans[CUBEMARS] = (12.5, 50.0, 25.0)
    names = {DAMIAO: "damiao", ROBSTRIDE: "robstride", ODRIVE: "odrive", CUBEMARS: "cubemars"}
    motors = [
        motor(id, f"joint{id}", names[id], spans[id], (-0.9, 0.8), 3.0, 20.0, reply=16 + id, push=1.0)
        for id in spans
    ]
    return CanLimits("arm", 0.01, 1_000_000, "gantry", {each.id: each for each in motors})


def reply_frame(id: int, data: bytes, *, extended: bool = False, remote: bool = False) -> bytes:
    """A line of text."""
    letter = ("R" if extended else "r") if remote else ("T" if extended else "t")
    width = 8 if extended else 3
    return f"{letter}{id:0{width}X}{len(data)}{data.hex().upper()}\r".encode()


@dataclass
class Node:
    """One motor."""

    motor: Motor
    place: float  # words
    on: bool = False
    ticks: int = 0  # of its watchdog
    velocity: float = 0.0  # words/s
    goal: float | None = None
    fed: float = 0.0

    def fields(self) -> bytes:
        """Position, velocity and torque, of the packed families."""
        place = max(0, min(65535, round(self.place)))
        return bytes((place >> 8, place & 255, 0x7F, 0xF7, 0xFF))


@dataclass
class Nodes:
    """All of them, behind an adapter."""

    limits: CanLimits
    nodes: dict[int, Node] = field(init=False)
    waiting: list[tuple[float, bytes]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.nodes = {
            id: Node(each, word(each.family, each.position, START[id]))
            for id, each in self.limits.servos.items()
        }
        self._lines = Lines()

    # ------------------------------------------------------------------------- the bus

    def receive(self, data: bytes, now: float) -> None:
        for line in self._lines.take(data):
            try:
                self._take(frame(line), now)
            except Malformed:
                continue

    def due(self) -> float:
        return self.waiting[0][0] if self.waiting else float("inf")

    def take(self, now: float) -> bytes:
        came = b"".join(data for time, data in self.waiting if time <= now)
        self.waiting = [each for each in self.waiting if each[0] > now]
        return came

    def _answer(self, now: float, line: bytes) -> None:
        self.waiting.append((now + DELAY, line))

    def _take(self, one: Frame, now: float) -> None:
        if one.extended:
            self._robstride(self.nodes.get(one.id & 255), one, now)
        elif one.id == 0x7FF:
            self._register(self.nodes.get(one.data[0]), one.data, now)
        elif one.id in (DAMIAO, CUBEMARS):
            self._packed(self.nodes[one.id], one.data, now)
        elif one.id >> 5 == ODRIVE:
            self._odrive(self.nodes[ODRIVE], one, now)

    # ------------------------------------------------------------------------- families

    def _packed(self, node: Node, data: bytes, now: float) -> None:
        if data[:7] == b"\xff" * 7 and data[7] in (0xFC, 0xFD):
            node.on = data[7] == 0xFC
        elif node.on and any((data[3] & 15, data[4])):
            node.place = data[0] << 8 | data[1]
        self._feedback(node, now)

    def _feedback(self, node: Node, now: float) -> None:
        if node.motor.family == "damiao":
            body = bytes((node.motor.id | node.on << 4,)) + node.fields() + bytes((30, 31))
            self._answer(now, reply_frame(node.motor.reply, body))
        else:
            self._answer(now, reply_frame(0, bytes((node.motor.id,)) + node.fields() + bytes((30, 0))))

    def _register(self, node: Node | None, data: bytes, now: float) -> None:
        if node is None:
            return
        if data[2] == 0xCC:
            self._feedback(node, now)
            return
        value = int.from_bytes(data[4:], "little")
        if data[2] == 0x55 and data[3] == 9:
            node.ticks = value
        if data[2] == 0x33 and data[3] == 9:
            value = node.ticks
        body = bytes((node.motor.id, 0, data[2], data[3])) + value.to_bytes(4, "little")
        self._answer(now, reply_frame(node.motor.reply, body))

    def _robstride(self, node: Node | None, one: Frame, now: float) -> None:
        if node is None:
            return
        kind = one.id >> 24
        data = one.data
        index = one.data[0] | one.data[1] << 8
        if kind in (3, 4):
            node.on = kind == 3
        if kind == 0x12 and index == 0x7028:
            node.ticks = int.from_bytes(data[4:], "little")
        if kind == 1 and node.on:
            node.place = data[0] << 8 | data[1]
        if kind == 0x11:
            angle = node.place * 2.0 * node.motor.position / 65535 - node.motor.position
            value = node.ticks.to_bytes(4, "little") if index == 0x7028 else struct.pack("<f", angle)
            self._answer(
                now, reply_frame(0x11 << 24 | node.motor.id << 8 | HOST, data[:4] + value, extended=True)
            )
        else:
            place = round(node.place)
            body = bytes((place >> 8, place & 255, 0x7F, 0xFF, 0x7F, 0xFF, 1, 0x2C))
            head = 2 << 24 | (2 if node.on else 0) << 22 | node.motor.id << 8 | HOST
            self._answer(now, reply_frame(head, body, extended=True))

    def _odrive(self, node: Node, one: Frame, now: float) -> None:
        what = one.id & 31
        if what == 7:
            node.on = one.data[0] == 8
        elif what == 0x0C:
            node.goal = struct.unpack("<f", one.data[:4])[0] * TURN
        elif what == 9:
            body = struct.pack("<ff", node.place / TURN, 0.0)
            self._answer(now, reply_frame(ODRIVE << 5 | 9, body))
            state = bytes(4) + bytes((8 if node.on else 1, 0, 0, 0))
            self._answer(now, reply_frame(ODRIVE << 5 | 1, state))
        if node.on and node.goal is not None:
            node.place = node.goal
