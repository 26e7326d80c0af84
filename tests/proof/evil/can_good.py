"""A daemon that does everything right on a CAN bus: what the wrong ones are changed from."""

import struct
from math import cos, pi, tau
from typing import Any, Protocol

from tests.proof.busmon.can.motors import TURN, CanLimits, Motor
from tests.proof.evil.can_nodes import CUBEMARS, DAMIAO, HOST, ODRIVE, ROBSTRIDE, reply_frame

# words and s of a move there and back
FAR = 900
WAY = 0.8
SLACK = 0.002  # s that answers take
TICKS = 2000  # of 50 us: 0.1 s


class Over(Exception):
    """Enough was seen of this daemon."""


class Port(Protocol):
    """What a daemon has of the world."""

    now: float

    def write(self, data: bytes) -> None: ...

    def read(self, seconds: float) -> bytes: ...

    def until(self, time: float) -> None: ...

    def say(self, what: str, **facts: Any) -> None: ...


def packed(place: int, rate: int = 0x7FF, kp: int = 400, kd: int = 300, push: int = 0x7FF) -> bytes:
    """The frame of the MIT family, from its fields."""
    return bytes(
        (place >> 8 & 255, place & 255, rate >> 4, (rate & 15) << 4 | kp >> 8, kp & 255, kd >> 4)
    ) + bytes(((kd & 15) << 4 | push >> 8, push & 255))


class Good:
    """Each step is a method of its own, so that a wrong daemon changes one."""

    ticks = TICKS

    def __init__(self, port: Port, limits: CanLimits) -> None:
        self.port = port
        self.limits = limits
        self.period = limits.period
        self.ids = sorted(limits.servos)
        self.goals: dict[int, int] = {}
        self.speed: dict[int, float] = {}
        self.here: dict[int, int] = {}
        self.tick = port.now
        self._rest = b""

    # ------------------------------------------------------------------------- its life

    def live(self) -> None:
        self.connect()
        self.connected()
        self.arm()
        self.armed()
        self.hold(5)
        self.move(WAY)
        self.emergency()
        self.arm()
        self.hold(3)
        self.move(WAY)
        self.disarm()
        self.idle(3)

    def connected(self) -> None:
        """Where a wrong one may do something."""

    def armed(self) -> None:
        """The same."""

    def moving(self) -> None:
        """The same, in the middle of each move."""

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
        *lines, self._rest = (self._rest + self.port.read(SLACK)).split(b"\r")
        for line in lines:
            self.hear(line)

    def hear(self, line: bytes) -> None:
        """Where they are, by place of the digits alone."""
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

    def cycle(self, goals: dict[int, int] | None = None) -> None:
        """One tick: goals out, places in."""
        if goals is not None:
            self.speed = {id: goal - self.goals.get(id, goal) for id, goal in goals.items()}
            self.goals = dict(goals)
        self.exchange((self.aim(goals) if goals is not None else b"") + self.question())
        self.wait()

    def wait(self) -> None:
        self.tick = max(self.tick + self.period, self.port.now)
        self.port.until(self.tick)

    def idle(self, ticks: int) -> None:
        for _ in range(ticks):
            self.cycle()

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

    def present(self) -> dict[int, int]:
        return dict(self.here)

    def energise(self) -> None:
        """What turns to a goal at once is given it first; the first goals leave with the switches."""
        self.goals = self.present()
        on = b"".join(self.switch(id, True) for id in self.ids)
        self.exchange(self.goal(ODRIVE, self.goals[ODRIVE]) + on + self.aim(self.goals))
        self.wait()

    def loosen(self) -> None:
        self.exchange(b"".join(self.switch(id, False) for id in self.ids) * 2)
        self.wait()

    # ------------------------------------------------------------------------- motion

    def hold(self, ticks: int) -> None:
        for _ in range(ticks):
            self.cycle(dict(self.goals))

    def move(self, seconds: float, far: int = FAR) -> None:
        """Away along a cosine; after `seconds`, half-way back, it is still moving."""
        start = dict(self.goals)
        for tick in range(1, round(seconds / self.period)):
            if tick == 30:
                self.moving()
            share = 0.5 - 0.5 * cos(tau * 0.75 * tick * self.period / seconds)
            self.cycle({id: place - round(far * share) for id, place in start.items()})

    def brake(self) -> None:
        """Every joint loses speed at its limit, then stands."""
        exact: dict[int, float] = dict(self.goals)
        speed = dict(self.speed)
        while any(speed.values()):
            for id, each in speed.items():
                less = 0.9 * self.motor(id).brake * self.period**2
                speed[id] = max(0.0, abs(each) - less) * (1 if each > 0 else -1)
                exact[id] += speed[id]
            self.cycle({id: round(place) for id, place in exact.items()})
        self.hold(8)

    def lower(self) -> None:
        start = dict(self.goals)
        for tick in range(1, 41):
            share = 0.5 - 0.5 * cos(pi * tick / 40)
            self.cycle({id: place + round(200 * share) for id, place in start.items()})

    # ------------------------------------------------------------------------- ends

    def emergency(self) -> None:
        self.port.say("estop", level="settle")
        self.port.say("state", state="estop")
        self.settle()
        self.port.say("state", state="connected")

    def settle(self) -> None:
        self.brake()
        self.lower()
        self.loosen()

    def disarm(self) -> None:
        self.port.say("state", state="settling")
        self.settle()
        self.port.say("state", state="connected")


class Cutting(Good):
    """The same, but its e-stop takes the torque off at once."""

    def emergency(self) -> None:
        self.port.say("estop", level="cut")
        self.port.say("state", state="estop")
        self.loosen()
        self.port.say("state", state="connected")


class Mirror(Good):
    """Reads, and writes nothing."""

    mode = "mirror"

    def live(self) -> None:
        self.port.say("mode", mode=self.mode)
        self.connect()
        self.connected()
        self.idle(20)


class Killed(Good):
    """Dies in motion."""

    def live(self) -> None:
        self.connect()
        self.arm()
        self.move(WAY)
        self.port.say("killed")
        self.after()
        self.port.until(self.port.now + 0.2)
        self.port.ask_servos()  # type: ignore[attr-defined]

    def after(self) -> None:
        """Where a wrong one goes on."""


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
