"""Wrong ends on a CAN bus: W6 after an e-stop, W7 silence and watchdogs, W10 mirrors, W11 after the kill."""

from tests.proof.evil import daemon_life
from tests.proof.evil.can_good import EVILS, Cutting, Good, Killed, Mirror, packed
from tests.proof.evil.can_nodes import CUBEMARS, DAMIAO, reply_frame
from tests.proof.evil.daemon_life import Over


@EVILS.breaks("W6")
class Accelerates(Good):
    """The first goals after the e-stop go on faster than before."""

    def brake(self) -> None:
        for more in (10, 20):
            self.cycle({id: goal + round(self.speed[id]) + more for id, goal in self.goals.items()})
        super().brake()


EVILS.breaks("W6")(type("GoesOn", (daemon_life.GoesOn, Good), {}))
EVILS.breaks("W6")(type("NeverLetsGo", (daemon_life.NeverLetsGo, Good), {}))
EVILS.breaks("W6")(type("LateCut", (daemon_life.LateCut, Cutting), {}))
EVILS.breaks("W6")(type("GoalAfterCut", (daemon_life.GoalAfterCut, Cutting), {}))


@EVILS.breaks("W6")
class LetsGoOfSome(Good):
    """Torque off, but for one."""

    def settle(self) -> None:
        self.brake()
        self.exchange(b"".join(self.switch(id, False) for id in self.ids[1:]))
        self.idle(450)
        raise Over


# ------------------------------------------------------------------------------------------- W7


# Off, as the motors are delivered; 1 s; one count more than is allowed.
EVILS.derive("W7", "NoWatchdog", Good, ticks=0)
EVILS.derive("W7", "LongWatchdog", Good, ticks=20_000)
EVILS.derive("W7", "JustTooLongWatchdog", Good, ticks=2001)


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
        self.exchange(self.register(0x55, 9, self.ticks))


@EVILS.breaks("W7")
class WatchdogOfOneMissing(Good):
    """That of the other family is forgotten."""

    def guard(self) -> None:
        self.exchange(self.register(0x55, 9, self.ticks))


@EVILS.breaks("W7")
class AcknowledgementForAReadBack(Good):
    """Takes the echo of what it wrote for what the motor holds."""

    def prove(self) -> None:
        self.exchange(self.parameter(0x11, 0x7028))


@EVILS.breaks("W7")
class WatchdogOffUnderTorque(Good):
    """Switched off while armed, so that nothing disturbs."""

    def armed(self) -> None:
        self.hold(2)
        self.exchange(self.register(0x55, 9, 0))
        self.hold(4)
        raise Over


@EVILS.breaks("W7")
class WatchdogLongerUnderTorque(Good):
    def moving(self) -> None:
        self.exchange(self.parameter(0x12, 0x7028, 20_000))


class Slow(daemon_life.Silent, Good):
    """Moves slowly, so that a silence breaks no rule of motion."""

    slower = 4


EVILS.derive("W7", "Silence", Slow)
EVILS.derive("W7", "ShortSilence", Slow, lasts=0.065)
EVILS.breaks("W7")(type("SilentForEver", (daemon_life.SilentForEver, Good), {}))


@EVILS.breaks("W7")
class StarvesOne(Good):
    """All motors but one get goals; its watchdog runs out while the others go on."""

    def aim(self, goals: dict[int, int]) -> bytes:
        starved = 0.4 < self.port.now < 2.0
        return super().aim({id: place for id, place in goals.items() if not (starved and id == CUBEMARS)})

    def move(self, seconds: float) -> None:
        super().move(seconds * 4)


# ------------------------------------------------------------------------------------------- W10


class Says(Mirror):
    """A mirror that sends one text."""

    def text(self) -> bytes:
        raise NotImplementedError

    def connected(self) -> None:
        self.exchange(self.text())
        self.wait()


EVILS.derive("W10", "MirrorWritesGoal", Says, text=lambda self: reply_frame(DAMIAO, packed(0x7FFF)))
EVILS.derive("W10", "MirrorTakesTorqueOff", Says, text=lambda self: self.switch(DAMIAO, False))
EVILS.derive("W10", "MirrorTakesTorqueOn", Says, text=lambda self: self.switch(CUBEMARS, True))
# The empty command takes the robot from its holder.
EVILS.derive("W10", "MirrorAsksByAnEmptyCommand", Says, text=lambda self: self.limp())
EVILS.derive("W10", "MirrorSetsAWatchdog", Says, text=lambda self: self.register(0x55, 9, 2000))
EVILS.derive("W10", "MirrorClearsAFault", Says, text=lambda self: reply_frame(DAMIAO, b"\xff" * 7 + b"\xfb"))
EVILS.derive(
    "W10", "SimulationWrites", Says, mode="sim", text=lambda self: reply_frame(CUBEMARS, packed(0x7FFF))
)


# ------------------------------------------------------------------------------------------- W11


@EVILS.breaks("W11")
class FrameAfterTheKill(Killed):
    """Something of it lives on and sends the next goals."""

    def after(self) -> None:
        self.port.write(self.aim(self.goals))


@EVILS.breaks("W11")
class ReaderOutlivesItsWriter(Killed):
    """Only its reader lives on."""

    def after(self) -> None:
        self.port.write(self.question())


@EVILS.breaks("W11")
class MotorGoesOn(Killed):
    """Its watchdog was not what it was thought to be: it still turns 120 ms later."""

    def after(self) -> None:
        self.port.nodes.nodes[DAMIAO].velocity = 300.0  # type: ignore[attr-defined]
