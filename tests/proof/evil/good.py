"""A daemon on a Dynamixel bus that does everything right: what the wrong ones are changed from."""

from typing import Protocol

from tests.proof.busmon.limits import Limits
from tests.proof.busmon.packet import make
from tests.proof.evil.daemon_life import WAY, CuttingLife, DaemonLife, KilledLife, LifePort, MirrorLife
from tests.proof.evil.registry import WrongDaemons

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
SLACK = 0.002  # s


class Port(LifePort, Protocol):
    """A daemon's access to the world."""

    def read(self, count: int, timeout: float) -> bytes: ...


def word(value: int, size: int = 4) -> bytes:
    return value.to_bytes(size, "little", signed=value < 0)


class Good(DaemonLife):
    """A right daemon that writes and reads all servos with sync packets."""

    port: Port
    limits: Limits

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

    def talk(self, goals: bytes) -> None:
        self.here |= self.ask(POSITION, 4, goals)

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


EVILS: WrongDaemons[Good] = WrongDaemons()


class Cutting(CuttingLife, Good):
    """A right daemon whose e-stop takes the torque off at once."""


class Mirror(MirrorLife, Good):
    """A right daemon that reads, and writes nothing."""


class Killed(KilledLife, Good):
    """A right daemon that dies in motion."""


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
