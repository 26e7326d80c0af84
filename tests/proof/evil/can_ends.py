"""Wrong ends on a CAN bus: W6 after an e-stop, W7 silence and watchdogs, W10 mirrors, W11 after the kill."""

from tests.proof.evil.can_good import Cutting, Good, Killed, Mirror, Over, packed
from tests.proof.evil.can_nodes import CUBEMARS, DAMIAO, reply_frame
from tests.proof.evil.can_registry import breaks


@breaks("W6")
class Accelerates(Good):
    """The first goals after the e-stop go on faster than before."""

    def brake(self) -> None:
        for more in (10, 20):
            self.cycle({id: goal + round(self.speed[id]) + more for id, goal in self.goals.items()})
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
class NeverLetsGo(Good):
    """Stands, and torque is still on 5 s later."""

    def emergency(self) -> None:
        self.port.say("estop", level="settle")
        self.port.say("state", state="estop")
        self.brake()
        self.hold(500)
        raise Over


@breaks("W6")
class LetsGoOfSome(Good):
    """Torque off, but for one."""

    def emergency(self) -> None:
        self.port.say("estop", level="settle")
        self.port.say("state", state="estop")
        self.brake()
        self.exchange(b"".join(self.switch(id, False) for id in self.ids[1:]))
        self.idle(450)
        raise Over


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
        raise Over


# ------------------------------------------------------------------------------------------- W7


@breaks("W7")
class NoWatchdog(Good):
    """Off, as it is delivered."""

    ticks = 0


@breaks("W7")
class LongWatchdog(Good):
    """One second."""

    ticks = 20_000


@breaks("W7")
class JustTooLongWatchdog(Good):
    ticks = 2001


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
        self.exchange(self.register(0x55, 9, self.ticks))


@breaks("W7")
class WatchdogOfOneMissing(Good):
    """That of the other family is forgotten."""

    def guard(self) -> None:
        self.exchange(self.register(0x55, 9, self.ticks))


@breaks("W7")
class AcknowledgementForAReadBack(Good):
    """Takes the echo of what it wrote for what the motor holds."""

    def prove(self) -> None:
        self.exchange(self.parameter(0x11, 0x7028))


@breaks("W7")
class WatchdogOffUnderTorque(Good):
    """Switched off while armed, so that nothing disturbs."""

    def armed(self) -> None:
        self.hold(2)
        self.exchange(self.register(0x55, 9, 0))
        self.hold(4)
        raise Over


@breaks("W7")
class WatchdogLongerUnderTorque(Good):
    def moving(self) -> None:
        self.exchange(self.parameter(0x12, 0x7028, 20_000))


class Silent(Good):
    """Nothing for so long in motion, and on it goes."""

    lasts = 0.1

    def moving(self) -> None:
        self.port.until(self.port.now + self.lasts)
        self.tick = self.port.now

    def move(self, seconds: float, far: int = 900) -> None:
        super().move(seconds * 4, far)


@breaks("W7")
class Silence(Silent):
    """100 ms."""


@breaks("W7")
class ShortSilence(Silent):
    """65 ms."""

    lasts = 0.065


@breaks("W7")
class SilentForEver(Good):
    """Armed, and then it hangs."""

    def moving(self) -> None:
        self.port.until(self.port.now + 2.0)
        raise Over


@breaks("W7")
class StarvesOne(Good):
    """Everybody is spoken to but one, whose watchdog runs out while the others go on."""

    def aim(self, goals: dict[int, int]) -> bytes:
        starved = 0.4 < self.port.now < 2.0
        return super().aim({id: place for id, place in goals.items() if not (starved and id == CUBEMARS)})

    def move(self, seconds: float, far: int = 900) -> None:
        super().move(seconds * 4, far)


# ------------------------------------------------------------------------------------------- W10


class Says(Mirror):
    def text(self) -> bytes:
        raise NotImplementedError

    def connected(self) -> None:
        self.exchange(self.text())
        self.wait()


@breaks("W10")
class MirrorWritesGoal(Says):
    """A mirror that pushes a little."""

    def text(self) -> bytes:
        return reply_frame(DAMIAO, packed(0x7FFF))


@breaks("W10")
class MirrorTakesTorqueOff(Says):
    """A mirror that means well."""

    def text(self) -> bytes:
        return self.switch(DAMIAO, False)


@breaks("W10")
class MirrorTakesTorqueOn(Says):
    def text(self) -> bytes:
        return self.switch(CUBEMARS, True)


@breaks("W10")
class MirrorAsksByAnEmptyCommand(Says):
    """Whoever holds the robot now holds it no more."""

    def text(self) -> bytes:
        return self.limp()


@breaks("W10")
class MirrorSetsAWatchdog(Says):
    def text(self) -> bytes:
        return self.register(0x55, 9, 2000)


@breaks("W10")
class MirrorClearsAFault(Says):
    def text(self) -> bytes:
        return reply_frame(DAMIAO, b"\xff" * 7 + b"\xfb")


@breaks("W10")
class SimulationWrites(Says):
    """A simulation whose goals reach the bus."""

    mode = "sim"

    def text(self) -> bytes:
        return reply_frame(CUBEMARS, packed(0x7FFF))


# ------------------------------------------------------------------------------------------- W11


@breaks("W11")
class FrameAfterTheKill(Killed):
    """Something of it lives on and sends the next goals."""

    def after(self) -> None:
        self.port.write(self.aim(self.goals))


@breaks("W11")
class ReaderOutlivesItsWriter(Killed):
    """Only its reader lives on."""

    def after(self) -> None:
        self.port.write(self.question())


@breaks("W11")
class MotorGoesOn(Killed):
    """Its watchdog was not what it was thought to be: it still turns 120 ms later."""

    def after(self) -> None:
        self.port.nodes.nodes[DAMIAO].velocity = 300.0  # type: ignore[attr-defined]
