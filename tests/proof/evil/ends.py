"""Wrong ends: W6 after an e-stop, W7 silence and watchdogs, W9 talkers, W10 mirrors, W11 after the kill."""

from tests.proof.busmon.packet import make
from tests.proof.evil import daemon_life
from tests.proof.evil.good import (
    EVILS,
    GAINS,
    PING,
    REBOOT,
    WATCHDOG,
    WRITE,
    Cutting,
    Good,
    Killed,
    Mirror,
    word,
)


@EVILS.breaks("W6")
class Accelerates(Good):
    """The first goals after the e-stop go on faster than before."""

    def brake(self) -> None:
        for more in (3, 6):
            self.cycle({id: goal + round(self.speed[id]) + more for id, goal in self.goals.items()})
        super().brake()


@EVILS.breaks("W6")
class GoesOn(daemon_life.GoesOn, Good):
    """Neither faster nor slower: as if nothing had happened."""


@EVILS.breaks("W6")
class BrakesTooLate(Good):
    """Brakes after 50 ms."""

    def brake(self) -> None:
        self.go_on(5)
        super().brake()


@EVILS.breaks("W6")
class NeverLetsGo(daemon_life.NeverLetsGo, Good):
    """Stands, and torque is still on 5 s later."""


@EVILS.breaks("W6")
class LetsGoOfSome(Good):
    """Torque off, but for one."""

    def settle(self) -> None:
        self.brake()
        self.port.write(self.sync_write(64, dict.fromkeys(self.ids[1:], b"\0")) * 2)
        self.wait()
        self.idle(450)
        self.loosen()


@EVILS.breaks("W6")
class LateCut(daemon_life.LateCut, Cutting):
    """Level cut, and it takes 100 ms."""


@EVILS.breaks("W6")
class GoalAfterCut(daemon_life.GoalAfterCut, Cutting):
    """Level cut, and one more goal."""


# ------------------------------------------------------------------------------------------- W7


class Guards(Good):
    """Sets the watchdog to something else."""

    value = b"\5"

    def watchdogs(self) -> bytes:
        return self.all(WATCHDOG, self.value)

    def guard(self) -> None:
        self.goals = self.present()
        self.port.write(self.all(WATCHDOG, b"\0") + self.aim(self.goals) + self.watchdogs())
        self.wait()

    def prove(self) -> None:
        self.ask(WATCHDOG, 1)
        self.wait()


@EVILS.breaks("W7")
class NoWatchdog(Guards):
    """Off."""

    value = b"\0"

    def energise(self) -> None:
        self.place()
        super().energise()


@EVILS.breaks("W7")
class LongWatchdog(Guards):
    """2.54 s: too long to be one."""

    value = b"\x7f"


@EVILS.breaks("W7")
class JustTooLongWatchdog(Guards):
    """120 ms."""

    value = b"\6"


@EVILS.breaks("W7")
class WatchdogNotReadBack(Good):
    """Written and believed."""

    def prove(self) -> None:
        """Not done."""


@EVILS.breaks("W7")
class WatchdogReadTooEarly(Good):
    """Read back, and then written once more."""

    def prove(self) -> None:
        super().prove()
        self.port.write(self.all(WATCHDOG, b"\5"))
        self.wait()


@EVILS.breaks("W7")
class WatchdogOfOneMissing(Guards):
    """All but the last."""

    def watchdogs(self) -> bytes:
        return self.sync_write(WATCHDOG, dict.fromkeys(self.ids[:-1], self.value))


@EVILS.breaks("W7")
class WatchdogOffUnderTorque(Good):
    """Switched off while armed, so that nothing disturbs."""

    def armed(self) -> None:
        self.hold(2)
        self.port.write(make(self.ids[0], WRITE, word(WATCHDOG, 2) + b"\0"))
        self.port.read(11, 0.003)
        self.cycle(dict(self.goals))
        self.hold(3)


@EVILS.breaks("W7")
class WatchdogLongerUnderTorque(Good):
    """Made longer in motion."""

    def moving(self) -> None:
        self.port.write(make(self.ids[0], WRITE, word(WATCHDOG, 2) + b"\x32"))
        self.port.read(11, 0.003)
        self.wait()


@EVILS.breaks("W7")
class Silence(daemon_life.Silent, Good):
    """100 ms of nothing in motion, and on it goes."""


@EVILS.breaks("W7")
class ShortSilence(Silence):
    """65 ms."""

    lasts = 0.065


@EVILS.breaks("W7")
class SilentForEver(daemon_life.SilentForEver, Good):
    """Armed, and then it hangs."""


# ------------------------------------------------------------------------------------------- W9


@EVILS.breaks("W9")
class SecondTalker(Good):
    """Somebody else asks while the first one waits for its answer."""

    def moving(self) -> None:
        self.port.write(self.reading())
        self.port.until(self.port.now + 0.00005)
        self.port.write(make(self.ids[0], PING))
        self.port.read(64, 0.004)
        self.wait()


@EVILS.breaks("W9")
class SecondWriter(Good):
    """Somebody else repeats the goals while an answer is on the wire: right goals, wrong moment."""

    def moving(self) -> None:
        self.hold(25)
        self.port.write(self.reading(64, 40))
        self.port.until(self.port.now + 0.0002)
        self.port.write(self.aim(self.goals))
        self.port.read(200, 0.004)
        self.wait()


@EVILS.breaks("W9")
class ImpatientReader(Good):
    """Does not wait for the end of an answer."""

    def moving(self) -> None:
        for _ in range(3):
            self.port.write(self.reading(64, 80))
            self.port.until(self.port.now + 0.0005)
        self.port.read(4000, 0.008)
        self.wait()


# ------------------------------------------------------------------------------------------- W10


class Writes(Mirror):
    """A mirror that sends one packet."""

    def packet(self) -> bytes:
        raise NotImplementedError

    def connected(self) -> None:
        self.port.write(self.packet())
        self.port.read(11, 0.003)
        self.wait()


MirrorWritesGoal = EVILS.derive(
    "W10", "MirrorWritesGoal", Writes, packet=lambda self: self.aim(self.present())
)
SimulationWrites = EVILS.derive("W10", "SimulationWrites", MirrorWritesGoal, mode="sim")
EVILS.derive("W10", "MirrorTakesTorqueOff", Writes, packet=lambda self: self.torque(0))
EVILS.derive("W10", "MirrorTakesTorqueOn", Writes, packet=lambda self: self.torque(1))
EVILS.derive("W10", "MirrorRestarts", Writes, packet=lambda self: make(self.ids[0], REBOOT))
EVILS.derive("W10", "MirrorSetsGains", Writes, packet=lambda self: self.all(GAINS, bytes(6)))


# ------------------------------------------------------------------------------------------- W11


@EVILS.breaks("W11")
class PacketAfterTheKill(Killed):
    """Something of it lives on and sends the next goals."""

    def after(self) -> None:
        self.cycle(dict(self.goals))


@EVILS.breaks("W11")
class ReaderOutlivesItsWriter(Killed):
    """Only its reader lives on, and keeps every watchdog fed."""

    def after(self) -> None:
        self.idle(10)


@EVILS.breaks("W11")
class ServoGoesOn(Killed):
    """A servo that was told to go slowly, and whose watchdog was not: it still turns 120 ms later."""

    def after(self) -> None:
        self.port.until(self.port.now + 0.02)
        self.port.bus.servos["bus_watchdog"][:] = 0  # type: ignore[attr-defined]
        self.port.bus.servos.muscles.position[:] -= 900.0  # type: ignore[attr-defined]
        self.port.until(self.port.now + 0.125)
        self.port.ask_servos()
