"""The life of a daemon on any bus: what the right daemons share, and the wrong ones are changed from.

It knows three things of a robot: ids, where it stands, and a period. Its life: connect, arm, hold, move,
e-stop in motion, reset, arm again, move, disarm.
"""

from math import cos, pi, tau
from typing import Any, Protocol

WAY = 0.8  # s of a move there and back


class Over(Exception):
    """Enough was seen of this daemon."""


class LifePort(Protocol):
    """A daemon's access to the world; `read` differs with the bus."""

    @property
    def now(self) -> float: ...

    def write(self, data: bytes) -> None: ...

    def until(self, time: float) -> None: ...

    def say(self, what: str, **facts: Any) -> None: ...

    def ask_servos(self) -> None: ...


class DaemonLife:
    """A right daemon. Each step is a method of its own, so that a wrong daemon changes one."""

    port: LifePort
    # Counts: a move, the way down before torque is off; ticks of rest after braking.
    far = 260
    sag = 80
    rest = 2

    def __init__(self, port: Any, limits: Any) -> None:
        self.port = port
        self.limits = limits
        self.period: float = limits.period
        self.ids: list[int] = sorted(limits.servos)
        self.goals: dict[int, int] = {}
        self.speed: dict[int, float] = {}
        self.here: dict[int, int] = {}
        self.tick = self.port.now

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
        """Hook of wrong daemons."""

    def armed(self) -> None:
        """Hook of wrong daemons."""

    def moving(self) -> None:
        """Hook of wrong daemons, in the middle of each move."""

    def stopped(self) -> None:
        """Hook of wrong daemons."""

    def disarmed(self) -> None:
        """Hook of wrong daemons."""

    # ------------------------------------------------------------------------- what differs with the bus

    def connect(self) -> None:
        raise NotImplementedError

    def arm(self) -> None:
        raise NotImplementedError

    def loosen(self) -> None:
        raise NotImplementedError

    def aim(self, goals: dict[int, int]) -> bytes:
        """Encode goals."""
        raise NotImplementedError

    def talk(self, goals: bytes) -> None:
        """Send goals and read all positions."""
        raise NotImplementedError

    # ------------------------------------------------------------------------- ticks

    def cycle(self, goals: dict[int, int] | None = None) -> None:
        """One tick: goals out, positions in."""
        if goals is not None:
            self.speed = {id: goal - self.goals.get(id, goal) for id, goal in goals.items()}
            self.goals = dict(goals)
        self.talk(b"" if goals is None else self.aim(goals))
        self.wait()

    def wait(self) -> None:
        self.tick = max(self.tick + self.period, self.port.now)
        self.port.until(self.tick)

    def idle(self, ticks: int) -> None:
        for _ in range(ticks):
            self.cycle()

    def hold(self, ticks: int) -> None:
        for _ in range(ticks):
            self.cycle(dict(self.goals))

    def present(self) -> dict[int, int]:
        """Positions of all devices, which may be their goals."""
        return dict(self.here)

    # ------------------------------------------------------------------------- motion

    def move(self, seconds: float) -> None:
        """Away along a cosine; after `seconds`, half-way back, it is still moving."""
        start = dict(self.goals)
        for tick in range(1, round(seconds / self.period)):
            if tick == 30:
                self.moving()
            share = 0.5 - 0.5 * cos(tau * 0.75 * tick * self.period / seconds)
            self.cycle({id: place - round(self.far * share) for id, place in start.items()})

    def go_on(self, ticks: int) -> None:
        """Move at the speed of the last tick."""
        speed = dict(self.speed)
        for _ in range(ticks):
            self.cycle({id: goal + round(speed[id]) for id, goal in self.goals.items()})

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
        self.hold(self.rest)

    def lower(self) -> None:
        """Slowly to where it would hang, here a little further."""
        start = dict(self.goals)
        for tick in range(1, 41):
            share = 0.5 - 0.5 * cos(pi * tick / 40)
            self.cycle({id: place + round(self.sag * share) for id, place in start.items()})

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


class CuttingLife(DaemonLife):
    """A daemon whose e-stop takes the torque off at once."""

    def emergency(self) -> None:
        self.port.say("estop", level="cut")
        self.port.say("state", state="estop")
        self.cut()
        self.port.say("state", state="connected")

    def cut(self) -> None:
        self.loosen()


class MirrorLife(DaemonLife):
    """A daemon that reads, and writes nothing."""

    mode = "mirror"

    def live(self) -> None:
        self.port.say("mode", mode=self.mode)
        self.connect()
        self.connected()
        self.idle(20)


class KilledLife(DaemonLife):
    """A daemon that dies in motion; the state after that is asked of the servos."""

    def live(self) -> None:
        self.connect()
        self.arm()
        self.move(WAY)
        self.port.say("killed")
        self.after()
        self.port.until(self.port.now + 0.2)
        self.port.ask_servos()

    def after(self) -> None:
        """Hook of wrong daemons."""


# ------------------------------------------------------------------------- wrong on any bus


class GoesOn(DaemonLife):
    """W6: after an e-stop neither faster nor slower, as if nothing had happened."""

    def brake(self) -> None:
        self.go_on(12)
        super().brake()


class NeverLetsGo(DaemonLife):
    """W6: stands, and torque is still on 5 s later."""

    def settle(self) -> None:
        self.brake()
        self.hold(500)
        self.loosen()


class LateCut(CuttingLife):
    """W6: level cut, and it takes 100 ms."""

    def loosen(self) -> None:
        self.idle(10)
        super().loosen()


class GoalAfterCut(CuttingLife):
    """W6: level cut, and one more goal."""

    def cut(self) -> None:
        self.hold(1)
        super().cut()


class SilentForEver(DaemonLife):
    """W7: armed, and then it hangs."""

    def moving(self) -> None:
        self.port.until(self.port.now + 2.0)
        self.tick = self.port.now


class Silent(DaemonLife):
    """W7: sends nothing for `lasts` s in a slow motion, then goes on."""

    lasts = 0.1
    slower = 3

    def moving(self) -> None:
        self.port.until(self.port.now + self.lasts)
        self.tick = self.port.now

    def move(self, seconds: float) -> None:
        super().move(seconds * self.slower)
