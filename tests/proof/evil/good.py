"""A daemon that does everything right, from the protocol's text: what the wrong ones are changed from.

It knows three things of a robot: ids, where it stands, and a period. Its life: connect, arm, hold, move,
e-stop in motion, reset, arm again, move, disarm.
"""

from math import cos, pi, tau
from typing import Any, Protocol

from tests.proof.busmon.limits import Limits
from tests.proof.busmon.packet import make

PING = 0x01
READ = 0x02
WRITE = 0x03
REG_WRITE = 0x04
ACTION = 0x05
FACTORY = 0x06
REBOOT = 0x08
CLEAR = 0x10
SYNC_READ = 0x82
SYNC_WRITE = 0x83
FAST = 0x8A
BULK_WRITE = 0x93
ALL = 254
TORQUE = 64
GAINS = 80
WATCHDOG = 98
PROFILE = 108
GOAL = 116
POSITION = 132
# counts and s of a move there and back
FAR = 260
WAY = 0.8
SLACK = 0.002  # s


class Over(Exception):
    """Enough was seen of this daemon."""


class Port(Protocol):
    """What a daemon has of the world."""

    now: float

    def write(self, data: bytes) -> None: ...

    def read(self, count: int, timeout: float) -> bytes: ...

    def until(self, time: float) -> None: ...

    def say(self, what: str, **facts: Any) -> None: ...


def word(value: int, size: int = 4) -> bytes:
    return value.to_bytes(size, "little", signed=value < 0)


class Good:
    """Each step is a method of its own, so that a wrong daemon changes one."""

    def __init__(self, port: Port, limits: Limits) -> None:
        self.port = port
        self.limits = limits
        self.ids = sorted(limits.servos)
        self.period = limits.period
        self.goals: dict[int, int] = {}
        self.speed: dict[int, float] = {}
        self.here: dict[int, int] = {}
        self.tick = port.now

    # ------------------------------------------------------------------------- its life

    def live(self) -> None:
        self.connect()
        self.connected()
        self.arm()
        self.armed()
        self.hold(5)
        self.move(WAY)
        self.emergency()
        self.stopped()
        self.arm()
        self.hold(3)
        self.move(WAY)
        self.disarm()
        self.disarmed()
        self.idle(3)

    def connected(self) -> None:
        """Where a wrong one may do something."""

    def armed(self) -> None:
        """The same."""

    def moving(self) -> None:
        """The same, in the middle of each move."""

    def stopped(self) -> None:
        """The same."""

    def disarmed(self) -> None:
        """The same."""

    # ------------------------------------------------------------------------- packets

    def sync_write(self, address: int, rows: dict[int, bytes]) -> bytes:
        size = len(next(iter(rows.values())))
        params = word(address, 2) + word(size, 2)
        return make(ALL, SYNC_WRITE, params + b"".join(bytes((id,)) + data for id, data in rows.items()))

    def all(self, address: int, data: bytes) -> bytes:
        return self.sync_write(address, dict.fromkeys(self.ids, data))

    def aim(self, goals: dict[int, int]) -> bytes:
        return self.sync_write(GOAL, {id: word(goal) for id, goal in goals.items()})

    def reading(self, address: int = POSITION, size: int = 4) -> bytes:
        return make(ALL, FAST, word(address, 2) + word(size, 2) + bytes(self.ids))

    # ------------------------------------------------------------------------- exchanges

    def ask(self, address: int, size: int, before: bytes = b"") -> dict[int, int]:
        """A register of everybody, behind what is written `before` in the same call."""
        count = 8 + len(self.ids) * (size + 4)
        self.port.write(before + self.reading(address, size))
        answer = self.port.read(count, count * 10 / self.limits.baud + SLACK)
        found = {}
        for number, id in enumerate(self.ids):
            at = 8 + number * (size + 4)
            if len(answer) == count and answer[at + 1] == id:
                found[id] = int.from_bytes(answer[at + 2 : at + 2 + size], "little", signed=size == 4)
        return found

    def cycle(self, goals: dict[int, int] | None = None) -> None:
        """One tick: goals out, positions in."""
        if goals is not None:
            self.speed = {id: goal - self.goals.get(id, goal) for id, goal in goals.items()}
            self.goals = dict(goals)
        before = self.aim(goals) if goals is not None else b""
        self.here |= self.ask(POSITION, 4, before)
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
        for id in self.ids:
            self.port.write(make(id, PING))
            self.port.read(14, 0.003)
        self.ask(TORQUE, 1)
        self.idle(3)
        self.port.say("state", state="connected")

    def arm(self) -> None:
        self.port.say("state", state="arming")
        self.idle(1)
        self.guard()
        self.prove()
        self.prepare()
        self.idle(1)
        self.place()
        self.energise()
        self.idle(2)
        self.port.say("state", state="armed")

    def guard(self) -> None:
        """Watchdogs cleared with goal := present, then armed, in one call."""
        now = self.present()
        self.goals = now
        self.port.write(self.all(WATCHDOG, b"\0") + self.aim(now) + self.all(WATCHDOG, b"\5"))
        self.wait()

    def prove(self) -> None:
        assert set(self.ask(WATCHDOG, 1).values()) == {5}
        self.wait()

    def prepare(self) -> None:
        gains = word(0, 2) + word(0, 2) + word(800, 2)
        self.port.write(self.all(GAINS, gains) + self.all(PROFILE, bytes(8)))
        self.wait()

    def present(self) -> dict[int, int]:
        """Where everybody is, and may be told to be."""
        return dict(self.here)

    def place(self) -> None:
        """Goal := present once more, read back."""
        self.goals = self.present()
        self.port.write(self.aim(self.goals))
        self.wait()
        held = self.ask(GOAL, 4)
        assert held == self.goals, (held, self.goals)
        self.idle(1)

    def energise(self) -> None:
        self.port.write(self.torque(1))
        assert set(self.ask(TORQUE, 1).values()) == {1}
        self.wait()

    def torque(self, on: int) -> bytes:
        return self.all(TORQUE, bytes((on,)))

    def loosen(self) -> None:
        self.port.write(self.torque(0) * 2)
        assert set(self.ask(TORQUE, 1).values()) == {0}
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
                less = 0.9 * self.limits.servos[id].brake * self.period**2
                speed[id] = max(0.0, abs(each) - less) * (1 if each > 0 else -1)
                exact[id] += speed[id]
            self.cycle({id: round(place) for id, place in exact.items()})
        self.hold(2)

    def lower(self) -> None:
        """Slowly to where it would hang, here a little further."""
        start = dict(self.goals)
        for tick in range(1, 41):
            share = 0.5 - 0.5 * cos(pi * tick / 40)
            self.cycle({id: place + round(80 * share) for id, place in start.items()})

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
    """Dies in motion; what it cannot know of any more is asked of the servos."""

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
    """Dies armed; another one finds the torque on and takes it over without a step."""

    def live(self) -> None:
        self.connect()
        self.arm()
        self.move(WAY)
        self.port.say("killed")
        self.port.until(self.port.now + 0.3)
        self.port.say("born")
        self.tick = self.port.now
        self.connect()
        self.arm()
        self.hold(5)
        self.disarm()
