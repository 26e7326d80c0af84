"""Wrong ends: W6 after an e-stop, W7 silence and watchdogs, W9 talkers, W10 mirrors, W11 after the kill."""

from tests.proof.evil.good import (
    GAINS,
    PING,
    REBOOT,
    WATCHDOG,
    WRITE,
    Cutting,
    Good,
    Killed,
    Mirror,
    make,
    word,
)
from tests.proof.evil.registry import breaks


@breaks("W6")
class Accelerates(Good):
    """The first goals after the e-stop go on faster than before."""

    def brake(self) -> None:
        for more in (3, 6):
            self.cycle({id: goal + round(self.speed[id]) - more for id, goal in self.goals.items()})
        super().brake()


@breaks("W6")
class GoesOn(Good):
    """Neither faster nor slower: as if nothing had happened."""

    def brake(self) -> None:
        speed = dict(self.speed)
        for _ in range(12):
            self.cycle({id: goal + round(speed[id]) for id, goal in self.goals.items()})
        super().brake()


@breaks("W6")
class BrakesTooLate(Good):
    """Thinks about it for 50 ms."""

    def brake(self) -> None:
        speed = dict(self.speed)
        for _ in range(5):
            self.cycle({id: goal + round(speed[id]) for id, goal in self.goals.items()})
        super().brake()


@breaks("W6")
class NeverLetsGo(Good):
    """Stands, and torque is still on 5 s later."""

    def emergency(self) -> None:
        self.port.say("estop", level="settle")
        self.port.say("state", state="estop")
        self.brake()
        self.hold(500)
        self.loosen()
        self.port.say("state", state="connected")


@breaks("W6")
class LetsGoOfSome(Good):
    """Torque off, but for one."""

    def emergency(self) -> None:
        self.port.say("estop", level="settle")
        self.port.say("state", state="estop")
        self.brake()
        self.port.write(self.sync_write(64, dict.fromkeys(self.ids[1:], b"\0")) * 2)
        self.wait()
        self.idle(450)
        self.loosen()
        self.port.say("state", state="connected")


@breaks("W6")
class LateCut(Cutting):
    """Level cut, and it takes 100 ms."""

    def loosen(self) -> None:
        self.idle(10)
        super().loosen()


@breaks("W6")
class GoalAfterCut(Cutting):
    """Level cut, and one more goal."""

    def emergency(self) -> None:
        self.port.say("estop", level="cut")
        self.port.say("state", state="estop")
        self.hold(1)
        self.loosen()
        self.port.say("state", state="connected")


# ------------------------------------------------------------------------------------------- W7


class Guards(Good):
    """Sets the watchdog to something else."""

    value = b"\5"

    def guard(self) -> None:
        self.goals = self.present()
        self.port.write(self.all(WATCHDOG, b"\0") + self.aim(self.goals) + self.all(WATCHDOG, self.value))
        self.wait()

    def prove(self) -> None:
        self.ask(WATCHDOG, 1)
        self.wait()


@breaks("W7")
class NoWatchdog(Guards):
    """Off."""

    value = b"\0"

    def energise(self) -> None:
        self.place()
        super().energise()


@breaks("W7")
class LongWatchdog(Guards):
    """2.54 s: too long to be one."""

    value = b"\x7f"


@breaks("W7")
class JustTooLongWatchdog(Guards):
    """120 ms."""

    value = b"\6"


@breaks("W7")
class WatchdogNotReadBack(Good):
    """Written and believed."""

    def prove(self) -> None:
        """Not done."""


@breaks("W7")
class WatchdogReadTooEarly(Good):
    """Read back, and then written once more."""

    def prove(self) -> None:
        super().prove()
        self.port.write(self.all(WATCHDOG, b"\5"))
        self.wait()


@breaks("W7")
class WatchdogOfOneMissing(Good):
    """All but the last."""

    def guard(self) -> None:
        self.goals = self.present()
        some = dict.fromkeys(self.ids[:-1], b"\5")
        self.port.write(self.all(WATCHDOG, b"\0") + self.aim(self.goals) + self.sync_write(WATCHDOG, some))
        self.wait()

    def prove(self) -> None:
        self.ask(WATCHDOG, 1)
        self.wait()


@breaks("W7")
class WatchdogOffUnderTorque(Good):
    """Switched off while armed, so that nothing disturbs."""

    def armed(self) -> None:
        self.hold(2)
        self.port.write(make(self.ids[0], WRITE, word(WATCHDOG, 2) + b"\0"))
        self.port.read(11, 0.003)
        self.cycle(dict(self.goals))
        self.hold(3)


@breaks("W7")
class WatchdogLongerUnderTorque(Good):
    """Made longer in motion."""

    def moving(self) -> None:
        self.port.write(make(self.ids[0], WRITE, word(WATCHDOG, 2) + b"\x32"))
        self.port.read(11, 0.003)
        self.wait()


@breaks("W7")
class Silence(Good):
    """100 ms of nothing in motion, and on it goes."""

    def moving(self) -> None:
        self.port.until(self.port.now + 0.1)
        self.tick = self.port.now

    def move(self, seconds: float, far: int = 260) -> None:
        super().move(seconds * 3, far)


@breaks("W7")
class ShortSilence(Silence):
    """65 ms."""

    def moving(self) -> None:
        self.port.until(self.port.now + 0.065)
        self.tick = self.port.now


@breaks("W7")
class SilentForEver(Good):
    """Armed, and then it hangs."""

    def moving(self) -> None:
        self.port.until(self.port.now + 2.0)
        self.tick = self.port.now


# ------------------------------------------------------------------------------------------- W9


@breaks("W9")
class SecondTalker(Good):
    """Somebody else asks while the first one waits for its answer."""

    def moving(self) -> None:
        self.port.write(self.reading())
        self.port.until(self.port.now + 0.00005)
        self.port.write(make(self.ids[0], PING))
        self.port.read(64, 0.004)
        self.wait()


@breaks("W9")
class SecondWriter(Good):
    """Somebody else repeats the goals while an answer is on the wire: right goals, wrong moment."""

    def moving(self) -> None:
        self.hold(25)
        self.port.write(self.reading(64, 40))
        self.port.until(self.port.now + 0.0002)
        self.port.write(self.aim(self.goals))
        self.port.read(200, 0.004)
        self.wait()


@breaks("W9")
class ImpatientReader(Good):
    """Does not wait for the end of an answer."""

    def moving(self) -> None:
        for _ in range(3):
            self.port.write(self.reading(64, 80))
            self.port.until(self.port.now + 0.0005)
        self.port.read(4000, 0.008)
        self.wait()


# ------------------------------------------------------------------------------------------- W10


@breaks("W10")
class MirrorWritesGoal(Mirror):
    """A mirror that pushes a little."""

    def connected(self) -> None:
        self.port.write(self.aim(self.present()))
        self.wait()


@breaks("W10")
class MirrorTakesTorqueOff(Mirror):
    """A mirror that means well."""

    def connected(self) -> None:
        self.port.write(self.torque(0))
        self.wait()


@breaks("W10")
class MirrorTakesTorqueOn(Mirror):
    def connected(self) -> None:
        self.port.write(self.torque(1))
        self.wait()


@breaks("W10")
class MirrorRestarts(Mirror):
    def connected(self) -> None:
        self.port.write(make(self.ids[0], REBOOT))
        self.port.read(11, 0.003)
        self.wait()


@breaks("W10")
class MirrorSetsGains(Mirror):
    """Only gains, only a little."""

    def connected(self) -> None:
        self.port.write(self.all(GAINS, bytes(6)))
        self.wait()


@breaks("W10")
class SimulationWrites(Mirror):
    """A simulation whose goals reach the bus."""

    mode = "sim"

    def connected(self) -> None:
        self.port.write(self.aim(self.present()))
        self.wait()


# ------------------------------------------------------------------------------------------- W11


@breaks("W11")
class PacketAfterTheKill(Killed):
    """Something of it lives on and sends the next goals."""

    def after(self) -> None:
        self.cycle(dict(self.goals))


@breaks("W11")
class ReaderOutlivesItsWriter(Killed):
    """Only its reader lives on, and keeps every watchdog fed."""

    def after(self) -> None:
        self.idle(10)


@breaks("W11")
class ServoGoesOn(Killed):
    """A servo that was told to go slowly, and whose watchdog was not: it still turns 120 ms later."""

    def after(self) -> None:
        self.port.until(self.port.now + 0.02)
        self.port.bus.servos["bus_watchdog"][:] = 0  # type: ignore[attr-defined]
        self.port.bus.servos.muscles.position[:] -= 900.0  # type: ignore[attr-defined]
        self.port.until(self.port.now + 0.125)
        self.port.ask_servos()  # type: ignore[attr-defined]
