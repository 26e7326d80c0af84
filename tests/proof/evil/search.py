"""A calibration that drives a joint against its stop, right and wrong: W1, W3, W5."""

from tests.proof.busmon.packet import make
from tests.proof.evil.good import EVILS, GOAL, POSITION, TORQUE, WATCHDOG, WRITE, Good, word

MODE = 11
CURRENT = 102


class Seeker(Good):
    """One servo alone, in current-based position mode, weak and slow, to the end of what it may be sent."""

    # raw; raw; counts a tick; counts
    mode = 5
    cap = 55
    step = 3
    beyond = 0

    def live(self) -> None:
        self.connect()
        self.port.say("state", state="calibrating")
        self.seek(self.ids[-1])
        self.port.say("state", state="connected")
        self.idle(3)

    def seek(self, id: int) -> None:
        self.begin(id)
        goal = self.here[id]
        end = self.limits.servos[id].stops[1] + self.beyond
        for aim in [goal, *range(goal, end, self.step), end]:
            self.here |= self.ask(POSITION, 4, self.sync_write(GOAL, {id: word(aim)}))
            self.wait()
        self.tell(id, TORQUE, b"\0")
        self.tell(id, MODE, b"\3")

    def begin(self, id: int) -> None:
        """Mode, cap, goal, watchdog, torque."""
        self.tell(id, MODE, bytes((self.mode,)))
        self.weaken(id)
        self.idle(1)
        for address, data in ((WATCHDOG, b"\0"), (GOAL, word(self.here[id])), (WATCHDOG, b"\5")):
            self.tell(id, address, data)
        self.ask(WATCHDOG, 1)
        self.wait()
        self.idle(1)
        self.tell(id, TORQUE, b"\1")

    def weaken(self, id: int) -> None:
        self.tell(id, CURRENT, word(self.cap, 2))

    def tell(self, id: int, address: int, data: bytes) -> None:
        """One register of one servo, and its answer."""
        self.port.write(make(id, WRITE, word(address, 2) + data))
        self.port.read(11, 0.003)
        self.wait()


@EVILS.breaks("W1")
class PastItsStop(Seeker):
    """One count further than a stop may lie."""

    beyond = 1


@EVILS.breaks("W3")
class Hurried(Seeker):
    step = 6


@EVILS.breaks("W5")
class Strong(Seeker):
    """With a little more than a search may use."""

    cap = 56


@EVILS.breaks("W5")
class Uncapped(Seeker):
    def weaken(self, id: int) -> None:
        """Nothing caps it but what it was set to."""


@EVILS.breaks("W5")
class InItsOwnMode(Seeker):
    """No current is capped."""

    mode = 3


@EVILS.breaks("W5")
class BothSides(Seeker):
    """Two joints at once."""

    def begin(self, id: int) -> None:
        super().begin(self.ids[0])
        super().begin(id)
