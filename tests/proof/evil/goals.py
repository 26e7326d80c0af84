"""Wrong goals: W1, W3, W4, W5."""

from tests.proof.busmon.packet import make
from tests.proof.evil.daemon_life import Over
from tests.proof.evil.good import EVILS, GOAL, WRITE, Good, word


class AtEdge(Good):
    """Walks to the end of a range in allowed steps; the next goal is `beyond` counts past it."""

    way = 1
    beyond = 1

    def armed(self) -> None:
        self.hold(2)
        id = self.ids[0]
        servo = self.limits.servos[id]
        end = servo.upper if self.way > 0 else servo.lower
        goals = dict(self.goals)
        least = int(servo.speed * self.period)
        while abs(end - goals[id]) > 3:
            goals[id] += self.way * min(least, abs(end - goals[id]) - 3)
            self.cycle(goals)
        goals[id] = end
        self.cycle(goals)
        self.hold(20)
        goals[id] = end + self.way * self.beyond
        self.cycle(goals)
        goals[id] = end
        self.cycle(goals)


@EVILS.breaks("W1")
class BeyondUpper(AtEdge):
    """A few counts past the upper end."""

    beyond = 12


@EVILS.breaks("W1")
class BeyondLower(AtEdge):
    way = -1
    beyond = 12


@EVILS.breaks("W1")
class OneCountBeyondUpper(AtEdge):
    """One count."""


@EVILS.breaks("W1")
class OneCountBeyondLower(AtEdge):
    way = -1


@EVILS.breaks("W1")
class WrongZero(Good):
    """Takes goals for angles: writes what is right for another encoder."""

    def moving(self) -> None:
        upper = self.limits.servos[self.ids[2]].upper
        goals = dict(self.goals)
        while goals[self.ids[2]] <= upper:
            goals[self.ids[2]] += 20
            self.cycle(goals)
        raise Over


@EVILS.breaks("W1")
class OneServoAlone(Good):
    """The last servo gets its goal by a packet of its own, past the end."""

    def armed(self) -> None:
        self.hold(2)
        id = self.ids[-1]
        upper = self.limits.servos[id].upper
        goals = dict(self.goals)
        while goals[id] < upper:
            goals[id] += min(20, upper - goals[id])
            self.cycle(goals)
        self.port.write(make(id, WRITE, word(GOAL, 2) + word(upper + 1)))
        self.port.read(11, 0.003)
        self.wait()


# ------------------------------------------------------------------------------------------- W3


class Step(Good):
    """One step that is too long by `more` counts, on the way of one servo."""

    servo = 1
    more = 2
    back = False

    def moving(self) -> None:
        id = self.ids[self.servo]
        most = int(self.limits.servos[id].speed * self.period + 1)
        goals = dict(self.goals)
        goals[id] -= most + self.more
        self.cycle(goals)
        while abs(self.goals[id] - self.here[id]) > 3:
            self.cycle(goals)


@EVILS.breaks("W3")
class TwoCountsTooFast(Step):
    """Two counts more than its speed allows."""


@EVILS.breaks("W3")
class OneCountTooFast(Step):
    servo = 0
    more = 1


@EVILS.breaks("W3")
class TooFastForThePowerOfTheGear(Step):
    """Takes the speed of the motor for that of the joint behind its gear."""

    more = 5


@EVILS.breaks("W3")
class JumpsAfterAFault(Good):
    """A fault; the hold that follows is where the robot was meant to go."""

    def moving(self) -> None:
        self.port.say("state", state="fault")
        goals = {id: goal - 40 for id, goal in self.goals.items()}
        self.cycle(goals)
        self.hold(20)
        self.port.say("state", state="armed")


@EVILS.breaks("W3")
class HoldsAtTheMeasuredPlace(Good):
    """Something holds a joint back; the goal jumps to where it was measured, under torque."""

    def armed(self) -> None:
        self.hold(2)
        goals = {id: goal + 27 for id, goal in self.goals.items()}
        goals[self.ids[1]] = self.goals[self.ids[1]] + 60
        self.cycle(goals)


@EVILS.breaks("W3")
class CatchesUp(Good):
    """Three ticks were missed; the next goal is where the motion should be by now."""

    def moving(self) -> None:
        self.port.until(self.port.now + 3 * self.period)
        far = {id: 4 * round(self.speed[id] or -10) for id in self.ids}
        self.cycle({id: goal + far[id] for id, goal in self.goals.items()})


@EVILS.breaks("W3")
class JumpsAfterRearming(Good):
    """Armed once more, it goes on where it was before, and torque is not yet on."""

    old: dict[int, int] | None = None

    def present(self) -> dict[int, int]:
        if self.old is None:
            self.old = {id: place - 100 for id, place in self.here.items()}
        return super().present()

    def place(self) -> None:
        super().place()
        assert self.old is not None
        if self.port.now > 1.0:
            self.port.write(self.aim(self.old))
            self.wait()
            self.port.write(self.aim(self.goals))
            self.wait()


# ------------------------------------------------------------------------------------------- W4


@EVILS.breaks("W4")
class GoalNotPresent(Good):
    """Torque on with a goal three counts from where the servo is: too little for a jump, and wrong."""

    def place(self) -> None:
        super().place()
        self.goals = {id: goal + 3 for id, goal in self.goals.items()}
        self.port.write(self.aim(self.goals))
        self.wait()


@EVILS.breaks("W4")
class StalePresent(Good):
    """Rests on a reading of 60 ms ago."""

    def place(self) -> None:
        super().place()
        for _ in range(6):
            self.ask(64, 1)
            self.wait()


@EVILS.breaks("W4")
class TorqueBeforeGoal(Good):
    """Switches torque on and then says where to."""

    def guard(self) -> None:
        self.goals = self.present()
        self.port.write(self.all(98, b"\5"))
        self.wait()

    def place(self) -> None:
        """Later."""


@EVILS.breaks("W4")
class OldGoalAfterRestart(Good):
    """A servo was restarted: its goal is gone, and torque goes on all the same."""

    def place(self) -> None:
        super().place()
        self.port.write(self.all(98, b"\0") + self.all(98, b"\5"))
        self.wait()
        self.prove()


@EVILS.breaks("W4")
class FirstGoalOffPosition(Good):
    """The first goal after torque-on is a step away: within the speed, and not where the servo is."""

    def energise(self) -> None:
        super().energise()
        self.goals = {id: goal + 8 for id, goal in self.goals.items()}
        self.cycle(dict(self.goals))


@EVILS.breaks("W4")
class NeverLooked(Good):
    """Goal := what it remembers; nobody has read a position yet."""

    def cycle(self, goals: dict[int, int] | None = None) -> None:
        if self.port.now < 0.2 and goals is None:
            self.here = {1: 2100, 2: 2300, 5: 1900}
            self.ask(146, 1)
            self.wait()
        else:
            super().cycle(goals)


# ------------------------------------------------------------------------------------------- W5


@EVILS.breaks("W5")
class GoalWhileConnected(Good):
    """Writes goals before anybody has armed."""

    def connected(self) -> None:
        self.port.write(self.aim(self.present()))
        self.wait()


@EVILS.breaks("W5")
class TorqueWhileDisarmed(Good):
    """Everything right but the word: nobody has asked it to arm."""

    def arm(self) -> None:
        say = self.port.say
        self.port.say = lambda what, **facts: None  # type: ignore[method-assign]
        try:
            say("state", state="arming")
            self.idle(1)
            self.guard()
            self.prove()
            self.prepare()
            self.idle(1)
            self.place()
            say("state", state="connected")
            self.energise()
        finally:
            self.port.say = say  # type: ignore[method-assign]
        self.port.say("state", state="armed")


@EVILS.breaks("W5")
class RearmsOneServo(Good):
    """A servo has lost its torque; it is switched on again in the middle of a motion."""

    def moving(self) -> None:
        id = self.ids[0]
        for _ in range(20):
            self.cycle(dict(self.goals))
        self.port.write(make(id, WRITE, word(64, 2) + b"\1"))
        self.port.read(11, 0.003)
        self.wait()
        self.cycle(dict(self.goals))


@EVILS.breaks("W5")
class GoalAfterDisarm(Good):
    """The last goal leaves once more after the robot was let go."""

    def disarmed(self) -> None:
        self.cycle(self.present())


@EVILS.breaks("W5")
class GoalWhileInhibited(Good):
    """Nothing may be written any more, and a goal is."""

    def moving(self) -> None:
        self.hold(20)
        self.port.say("state", state="inhibited")
        self.hold(1)
        self.port.say("state", state="armed")
