"""A daemon that does everything right on a CAN bus: what the wrong ones are changed from."""

import struct
from typing import Protocol

from tests.proof.busmon.can.motors import TURN, CanLimits, Motor
from tests.proof.evil.can_nodes import CUBEMARS, DAMIAO, HOST, ODRIVE, ROBSTRIDE, reply_frame
from tests.proof.evil.daemon_life import WAY, CuttingLife, DaemonLife, KilledLife, LifePort, MirrorLife
from tests.proof.evil.registry import WrongDaemons

SLACK = 0.002  # s that answers take
TICKS = 2000  # of 50 us: 0.1 s


class Port(LifePort, Protocol):
    """A daemon's access to the world."""

    def read(self, seconds: float) -> bytes: ...


def packed(place: int, rate: int = 0x7FF, kp: int = 400, kd: int = 300, push: int = 0x7FF) -> bytes:
    """The frame of the MIT family, from its fields."""
    return bytes(
        (place >> 8 & 255, place & 255, rate >> 4, (rate & 15) << 4 | kp >> 8, kp & 255, kd >> 4)
    ) + bytes(((kd & 15) << 4 | push >> 8, push & 255))


class Good(DaemonLife):
    """A right daemon of four families."""

    port: Port
    limits: CanLimits
    far = 900
    sag = 200
    rest = 8
    ticks = TICKS  # watchdog
    _unread = b""

    # ------------------------------------------------------------------------- frames

    def motor(self, id: int) -> Motor:
        return self.limits.servos[id]

    def goal(self, id: int, place: int) -> bytes:
        """One goal, at rest."""
        if id == ROBSTRIDE:
            body = struct.pack(">HHHH", place & 0xFFFF, 0x7FFF, 5000, 6000)
            return reply_frame(1 << 24 | 0x7FFF << 8 | id, body, extended=True)
        if id == ODRIVE:
            return reply_frame(id << 5 | 0x0C, struct.pack("<fhh", place / TURN, 0, 0))
        return reply_frame(id, packed(place))

    def aim(self, goals: dict[int, int]) -> bytes:
        return b"".join(self.goal(id, place) for id, place in goals.items())

    def switch(self, id: int, on: bool) -> bytes:
        if id == ROBSTRIDE:
            return reply_frame((3 if on else 4) << 24 | HOST << 8 | id, bytes(8), extended=True)
        if id == ODRIVE:
            return reply_frame(id << 5 | 7, (8 if on else 1).to_bytes(4, "little"))
        return reply_frame(id, b"\xff" * 7 + (b"\xfc" if on else b"\xfd"))

    def question(self) -> bytes:
        """Asks everybody where he is; a CubeMars tells only in answer to a command, here an empty one."""
        text = reply_frame(0x7FF, bytes((DAMIAO, 0, 0xCC, 0, 0, 0, 0, 0)))
        text += self.parameter(0x11, 0x7019)
        text += reply_frame(ODRIVE << 5 | 9, b"", remote=True)
        return text

    def parameter(self, kind: int, index: int, value: int = 0) -> bytes:
        body = index.to_bytes(2, "little") + bytes(2) + value.to_bytes(4, "little")
        return reply_frame(kind << 24 | HOST << 8 | ROBSTRIDE, body, extended=True)

    def register(self, what: int, number: int, value: int = 0) -> bytes:
        return reply_frame(0x7FF, bytes((DAMIAO, 0, what, number)) + value.to_bytes(4, "little"))

    # ------------------------------------------------------------------------- exchanges

    def exchange(self, text: bytes) -> None:
        """Say it, and take what comes."""
        self.port.write(text)
        *lines, self._unread = (self._unread + self.port.read(SLACK)).split(b"\r")
        for line in lines:
            self.hear(line)

    def hear(self, line: bytes) -> None:
        """Positions, by place of the digits alone."""
        text = line.decode()
        if text.startswith((f"t{self.motor(DAMIAO).reply:03X}8", "t0008")) and text[7:9] != "00":
            data = bytes.fromhex(text[5:])
            self.here[data[0] & 15] = data[1] << 8 | data[2]
        elif text.startswith("T02"):
            self.here[ROBSTRIDE] = int(text[10:14], 16)
        elif text.startswith("T11") and text[10:14] == "1970":
            angle = struct.unpack("<f", bytes.fromhex(text[18:26]))[0]
            span = self.motor(ROBSTRIDE).position
            self.here[ROBSTRIDE] = round((angle + span) * 65535 / (2 * span))
        elif text.startswith(f"t{ODRIVE << 5 | 9:03X}8"):
            self.here[ODRIVE] = round(struct.unpack("<f", bytes.fromhex(text[5:13]))[0] * TURN)

    def talk(self, goals: bytes) -> None:
        self.exchange(goals + self.question())

    # ------------------------------------------------------------------------- torque

    def connect(self) -> None:
        self.port.say("state", state="identifying")
        self.port.write(b"C\rS8\rO\r")
        self.idle(3)
        self.port.say("state", state="connected")

    def arm(self) -> None:
        self.port.say("state", state="arming")
        self.idle(1)
        self.guard()
        self.prove()
        self.prepare()
        self.exchange(self.limp() + self.question())
        self.energise()
        self.port.say("state", state="armed")
        self.hold(2)

    def limp(self) -> bytes:
        """An empty command, so that the one that tells nothing by itself tells where it is."""
        return reply_frame(CUBEMARS, packed(0x7FFF, kp=0, kd=0))

    def guard(self) -> None:
        self.exchange(self.register(0x55, 9, self.ticks) + self.parameter(0x12, 0x7028, self.ticks))

    def prove(self) -> None:
        self.exchange(self.register(0x33, 9) + self.parameter(0x11, 0x7028))

    def prepare(self) -> None:
        modes = reply_frame(ODRIVE << 5 | 0x0B, struct.pack("<ii", 3, 1))
        self.exchange(modes + self.parameter(0x12, 0x7005, 0) + self.register(0x55, 10, 1))

    def energise(self) -> None:
        """A motor that turns to a goal at once is given it first; the first goals leave with the switches."""
        self.goals = self.present()
        on = b"".join(self.switch(id, True) for id in self.ids)
        self.exchange(self.goal(ODRIVE, self.goals[ODRIVE]) + on + self.aim(self.goals))
        self.wait()

    def loosen(self) -> None:
        self.exchange(b"".join(self.switch(id, False) for id in self.ids) * 2)
        self.wait()


EVILS: WrongDaemons[Good] = WrongDaemons()


class Cutting(CuttingLife, Good):
    """A right daemon whose e-stop takes the torque off at once."""


class Mirror(MirrorLife, Good):
    """A right daemon that reads, and writes nothing."""


class Killed(KilledLife, Good):
    """A right daemon that dies in motion."""


class Reborn(Good):
    """Its bus goes away in motion and comes back: nothing of what was said before counts any more."""

    def live(self) -> None:
        self.connect()
        self.arm()
        self.move(WAY)
        self.port.say("state", state="fault")
        self.port.say("port", open=False)
        self.port.until(self.port.now + 0.5)
        self.port.say("port", open=True)
        self.port.say("state", state="connected")
        self.tick = self.port.now
        self.connect()
        self.arm()
        self.hold(5)
        self.disarm()
