"""Wrong goals and frames on a CAN bus: W1 to W5, W8."""

import struct
from collections.abc import Callable

from tests.proof.busmon.can.motors import TURN
from tests.proof.evil.can_good import EVILS, Good, packed
from tests.proof.evil.can_nodes import CUBEMARS, DAMIAO, HOST, ODRIVE, ROBSTRIDE, reply_frame
from tests.proof.evil.daemon_life import Over


class AtEdge(Good):
    """Walks to the end of a range in allowed steps; the next goal is `beyond` words past it."""

    id = DAMIAO
    way = 1
    beyond = 1

    def armed(self) -> None:
        motor = self.motor(self.id)
        goals = dict(self.goals)
        end = motor.upper if self.way > 0 else motor.lower
        while goals[self.id] != end:
            goals[self.id] += self.way * min(int(motor.speed * self.period), abs(end - goals[self.id]))
            self.cycle(goals)
        self.hold(3)
        goals[self.id] = end + self.way * self.beyond
        self.cycle(goals)
        raise Over


@EVILS.breaks("W1")
class BeyondUpper(AtEdge):
    """One word past the upper end."""


@EVILS.breaks("W1")
class BeyondLower(AtEdge):
    id = ROBSTRIDE
    way = -1


@EVILS.breaks("W1")
class BeyondInTurns(AtEdge):
    """One count, of one that takes floats."""

    id = ODRIVE


@EVILS.breaks("W1")
class WrongRange(Good):
    """Takes one motor's range for another's: 12.5 rad for 12.57, far out it is past the end."""

    def armed(self) -> None:
        motor = self.motor(ROBSTRIDE)
        goals = dict(self.goals)
        while goals[ROBSTRIDE] < motor.upper:
            goals[ROBSTRIDE] += min(70, motor.upper - goals[ROBSTRIDE])
            self.cycle(goals)
        goals[ROBSTRIDE] = 0x7FFF + round((motor.upper - 0x7FFF) * 12.57 / 12.5)
        self.cycle(goals)
        raise Over


# ------------------------------------------------------------------------------------------- W2


class SaysOnce(Good):
    """Sends one text more, while connected."""

    def text(self) -> bytes:
        raise NotImplementedError

    def connected(self) -> None:
        self.exchange(self.text())
        self.wait()


def says(rule: str, name: str, text: Callable[[Good], bytes]) -> None:
    """Add a daemon that sends one text more, which breaks the rule."""
    EVILS.derive(rule, name, SaysOnce, text=text)


# Writes the range of the position field of a Damiao.
says("W2", "SetsARange", lambda d: d.register(0x55, 21, 0x41480000))
# Velocity control.
says("W2", "ChangesTheMode", lambda d: d.register(0x55, 10, 3))
# Position and velocity as floats, on the id of another mode.
says("W2", "GoalOfAnotherMode", lambda d: reply_frame(0x100 + DAMIAO, struct.pack("<ff", 0.2, 1.0)))
says("W2", "RunsInAnotherMode", lambda d: d.parameter(0x12, 0x7005, 2))
# Past the motion frame, by a parameter.
says("W2", "WritesAPositionReference", lambda d: d.parameter(0x12, 0x7016, 0x3F800000))
says("W2", "ControlsVelocity", lambda d: reply_frame(ODRIVE << 5 | 0x0B, struct.pack("<ii", 2, 1)))
says("W2", "SaysAVelocity", lambda d: reply_frame(ODRIVE << 5 | 0x0D, struct.pack("<ff", 1.0, 0.0)))
# Axis state 3: it turns by itself.
says("W2", "Calibrates", lambda d: reply_frame(ODRIVE << 5 | 7, (3).to_bytes(4, "little")))
# Active report: the bus fills with what nobody asked for.
says(
    "W2",
    "ReportsByItself",
    lambda d: reply_frame(0x18 << 24 | HOST << 8 | ROBSTRIDE, bytes((1, 2, 3, 4, 5, 6, 1, 8)), extended=True),
)
# A special frame that it is not known to have.
says("W2", "ClearsAFaultOfCubeMars", lambda d: reply_frame(CUBEMARS, b"\xff" * 7 + b"\xfb"))


@EVILS.breaks("W2")
class Pushes(Good):
    """A feed-forward torque that nobody allowed."""

    def moving(self) -> None:
        self.exchange(reply_frame(DAMIAO, packed(self.goals[DAMIAO], push=0x900)))


@EVILS.breaks("W2")
class ChangesTheRunModeUnderTorque(Good):
    def moving(self) -> None:
        self.exchange(self.parameter(0x12, 0x7005, 0))


# ------------------------------------------------------------------------------------------- W3


class Step(Good):
    """One step too far."""

    id = DAMIAO
    more = 3

    def moving(self) -> None:
        goals = dict(self.goals)
        motor = self.motor(self.id)
        goals[self.id] -= int(motor.speed * self.period + 1.0 + motor.slack) + self.more
        self.cycle(goals)
        raise Over


@EVILS.breaks("W3")
class TooFast(Step):
    """Three words more than its speed allows."""


@EVILS.breaks("W3")
class OneWordTooFast(Step):
    id = ROBSTRIDE
    more = 1


@EVILS.breaks("W3")
class TooFastInTurns(Step):
    id = ODRIVE
    more = 1


@EVILS.breaks("W3")
class FeedsATooFastVelocityForward(Good):
    """Right places, and 5 rad/s where 3 are allowed."""

    def moving(self) -> None:
        self.exchange(reply_frame(DAMIAO, packed(self.goals[DAMIAO], rate=round((5.0 + 8.0) * 4095 / 16.0))))


@EVILS.breaks("W3")
class JumpsAfterAFault(Good):
    """A fault; the hold that follows is where the robot was meant to go."""

    def moving(self) -> None:
        self.port.say("state", state="fault")
        self.cycle({id: goal - 150 for id, goal in self.goals.items()})
        raise Over


@EVILS.breaks("W3")
class CatchesUp(Good):
    """Three ticks were missed; the next goal is where the motion should be by now."""

    def moving(self) -> None:
        self.port.until(self.port.now + 3 * self.period)
        self.cycle({id: goal + 4 * round(self.speed[id] or -30) for id, goal in self.goals.items()})


# ------------------------------------------------------------------------------------------- W4


@EVILS.breaks("W4")
class FirstGoalOffPosition(Good):
    """The first goal after torque-on is a step away: within the speed, and not where the motor is."""

    def energise(self) -> None:
        goals = self.present()
        self.goals = {id: goal + 20 for id, goal in goals.items()}
        on = b"".join(self.switch(id, True) for id in self.ids)
        self.exchange(self.goal(ODRIVE, goals[ODRIVE]) + on + self.aim(self.goals))
        self.wait()


@EVILS.breaks("W4")
class ThreeWordsOff(Good):
    """Three words from where it was read: too little for a jump, and wrong."""

    def present(self) -> dict[int, int]:
        return {id: place + 3 for id, place in self.here.items()}


@EVILS.breaks("W4")
class StalePresent(Good):
    """Rests on a reading of 60 ms ago."""

    def prove(self) -> None:
        self.exchange(self.limp() + self.question())
        super().prove()

    def prepare(self) -> None:
        self.energise()

    def energise(self) -> None:
        self.port.until(self.port.now + 0.06)
        super().energise()
        raise Over


@EVILS.breaks("W4")
class TorqueBeforeGoal(Good):
    """One that turns to its goal at once is switched on and then told where to."""

    def energise(self) -> None:
        self.goals = self.present()
        on = b"".join(self.switch(id, True) for id in self.ids)
        self.exchange(on + self.aim(self.goals))
        self.wait()


@EVILS.breaks("W4")
class SwitchesOnLate(Good):
    """A motor is switched on 60 ms after its position, which its goal was taken from."""

    def energise(self) -> None:
        self.exchange(self.goal(ODRIVE, self.present()[ODRIVE]))
        self.port.until(self.port.now + 0.06)
        self.exchange(b"".join(self.switch(id, True) for id in self.ids) + self.question())
        self.goals = self.present()
        self.exchange(self.aim(self.goals))
        self.wait()


@EVILS.breaks("W4")
class TakesAnAnswerForAPlace(Good):
    """A register's acknowledgement read as feedback: as near as the range has."""

    def present(self) -> dict[int, int]:
        return self.here | {DAMIAO: self.motor(DAMIAO).lower}

    def energise(self) -> None:
        super().energise()
        raise Over


@EVILS.breaks("W3")
class OldGoalAfterTheBusWasAway(Good):
    """The bus was gone; what it meant to say then is said now."""

    def moving(self) -> None:
        old = dict(self.goals)
        self.port.say("port", open=False)
        self.port.until(self.port.now + 0.2)
        self.port.say("port", open=True)
        self.port.write(self.aim({id: place - 30 for id, place in old.items()}))
        raise Over


# ------------------------------------------------------------------------------------------- W5


@EVILS.breaks("W5")
class GoalWhileConnected(Good):
    """Writes goals before anybody has armed."""

    def connected(self) -> None:
        self.exchange(self.limp() + self.question())
        self.port.write(self.aim(self.present()))
        self.wait()


@EVILS.breaks("W5")
class DampsWhileConnected(Good):
    """Without stiffness, but it is a command, and nobody has armed."""

    def connected(self) -> None:
        self.port.write(reply_frame(DAMIAO, packed(0x7FFF, kp=0)))
        self.wait()


@EVILS.breaks("W5")
class TorqueWhileConnected(Good):
    """Switches on one that has been given all that it needs, but nobody has asked it to arm."""

    def connected(self) -> None:
        self.port.write(self.switch(CUBEMARS, True))
        self.wait()


# ------------------------------------------------------------------------------------------- W8

# Where it is shall be zero.
says("W8", "NewZero", lambda d: reply_frame(DAMIAO, b"\xff" * 7 + b"\xfe"))
says(
    "W8",
    "NewZeroOfRobStride",
    lambda d: reply_frame(6 << 24 | HOST << 8 | ROBSTRIDE, b"\x01" + bytes(7), extended=True),
)
says("W8", "NewPlaceOfODrive", lambda d: reply_frame(ODRIVE << 5 | 0x19, bytes(4)))
says("W8", "Stores", lambda d: reply_frame(0x7FF, bytes((DAMIAO, 0, 0xAA, 1, 0, 0, 0, 0))))
says(
    "W8",
    "StoresInRobStride",
    lambda d: reply_frame(0x16 << 24 | HOST << 8 | ROBSTRIDE, bytes((1, 2, 3, 4, 5, 6, 7, 8)), extended=True),
)
says("W8", "GivesAnotherId", lambda d: d.register(0x55, 8, 5))
says(
    "W8",
    "GivesRobStrideAnotherId",
    lambda d: reply_frame(7 << 24 | 5 << 16 | HOST << 8 | ROBSTRIDE, bytes(8), extended=True),
)
says("W8", "GivesANodeAnotherId", lambda d: reply_frame(ODRIVE << 5 | 6, (5).to_bytes(4, "little")))
# An id that is not of this bus.
says("W8", "SpeaksToAStranger", lambda d: reply_frame(9, packed(0x7FFF)))
says("W8", "ReadsARegisterOfAStranger", lambda d: reply_frame(0x7FF, bytes((9, 0, 0x33, 9, 0, 0, 0, 0))))
# Announces eight bytes and sends two.
says("W8", "ShortData", lambda d: b"t0018AABB\r")
says("W8", "NineBytes", lambda d: b"t0019" + b"00" * 9 + b"\r")
# Four bytes to a motor that takes eight.
says("W8", "ShortCommand", lambda d: reply_frame(CUBEMARS, bytes(4)))
says("W8", "NoDigit", lambda d: b"t00180000000000G00000\r")
# A frame of CAN FD.
says("W8", "FlexibleRate", lambda d: b"d0018" + b"00" * 8 + b"\r")
# Two lines without an end between.
says(
    "W8",
    "RunTogether",
    lambda d: reply_frame(0x7FF, bytes((DAMIAO, 0, 0xCC, 0, 0, 0, 0, 0)))[:-1] * 2 + b"\r",
)
says("W8", "RemoteToAMotor", lambda d: reply_frame(DAMIAO, b"", remote=True))
# The adapter is set to 500 kbit/s.
says("W8", "AnotherRate", lambda d: b"C\rS6\rO\r")


@EVILS.breaks("W8")
class Unfinished(SaysOnce):
    """Half a line, and then nothing."""

    def connected(self) -> None:
        self.port.write(b"t0018AAB")
        self.port.until(self.port.now + 0.2)
        raise Over


# A goal in turns that is none.
says("W8", "NotANumber", lambda d: reply_frame(ODRIVE << 5 | 0x0C, struct.pack("<fhh", float("nan"), 0, 0)))


assert TURN == 16384
