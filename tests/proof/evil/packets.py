"""Wrong packets: W2 what may not be written, W8 what is no packet."""

from collections.abc import Callable

from tests.proof.busmon.packet import make
from tests.proof.evil.good import (
    ACTION,
    ALL,
    BULK_WRITE,
    CLEAR,
    EVILS,
    FACTORY,
    PING,
    READ,
    REBOOT,
    REG_WRITE,
    WRITE,
    Good,
    word,
)


class Sends(Good):
    """Sends one packet more, armed and standing still."""

    def packet(self) -> bytes:
        raise NotImplementedError

    def send(self) -> None:
        self.port.write(self.packet())
        self.port.read(64, 0.004)
        self.wait()

    def armed(self) -> None:
        self.send()
        self.hold(2)


class SendsDisarmed(Sends):
    """Sends it before arming."""

    def armed(self) -> None:
        """Not then."""

    def connected(self) -> None:
        self.send()


class RestartsAll(SendsDisarmed):
    """Sends it before arming, and waits a second for the servos to restart."""

    def connected(self) -> None:
        self.send()
        self.port.until(self.port.now + 1.0)
        self.tick = self.port.now
        self.idle(2)


def sends(rule: str, name: str, packet: Callable[[Good], bytes], base: type[Sends] = Sends) -> type[Good]:
    """Add a daemon that sends one packet more, which breaks the rule."""
    return EVILS.derive(rule, name, base, packet=packet)


def write(id: int, address: int, data: bytes) -> bytes:
    return make(id, WRITE, word(address, 2) + data)


def rows(daemon: Good) -> list[bytes]:
    """Rows of a sync write of all goals."""
    return [bytes((id,)) + word(goal) for id, goal in daemon.goals.items()]


def goals_by(rows: bytes) -> bytes:
    """A sync write of these rows to the goals."""
    return make(ALL, 0x83, word(116, 2) + word(4, 2) + rows)


# One register beside the goal: the goal velocity's upper half. Then only the low half of a goal.
sends("W2", "WrongAddress", lambda d: d.all(106, b"\0\0"))
sends("W2", "WrongLength", lambda d: d.all(116, word(2048, 2)))
# A goal of another mode.
GoalVelocity = sends("W2", "GoalVelocity", lambda d: d.all(104, word(40)))
# An EEPROM register while armed: the servo refuses it, and the daemon must not ask.
sends("W2", "Eeprom", lambda d: write(d.ids[0], 48, word(4095)))
# Another mode under torque: the joint would drop.
sends("W2", "WritesOperatingMode", lambda d: write(d.ids[1], 11, b"\x04"))
sends("W2", "NewId", lambda d: write(d.ids[0], 7, b"\x09"), SendsDisarmed)
# Servos of no robot included.
sends("W2", "WritesToBroadcastId", lambda d: write(ALL, 116, word(2048)))
sends("W2", "RestartOfAll", lambda d: make(ALL, REBOOT), RestartsAll)
# All settings but id and rate.
sends("W2", "FactoryReset", lambda d: make(d.ids[0], FACTORY, b"\2"), RestartsAll)
# The turn count is lost.
sends("W2", "ClearsTurns", lambda d: make(d.ids[0], CLEAR, bytes.fromhex("01 44 58 4c 22")), SendsDisarmed)
# A goal for a servo that is not of this robot. Then two goals for one servo.
sends("W2", "UnknownId", lambda d: d.aim(d.goals | {77: 2048}))
sends("W2", "IdTwice", lambda d: goals_by(b"".join([*rows(d), rows(d)[0]])))
# A goal that is stored now and acts later; then the order to act.
sends("W2", "LateGoal", lambda d: make(d.ids[0], REG_WRITE, word(116, 2) + word(d.goals[d.ids[0]])))
sends("W2", "LateAction", lambda d: make(ALL, ACTION))
# A bulk write, where each row names its register.
sends(
    "W2", "Bulk", lambda d: make(ALL, BULK_WRITE, rows(d)[0][:1] + word(116, 2) + word(4, 2) + rows(d)[0][1:])
)
# A register at another address.
sends("W2", "IndirectAddress", lambda d: write(d.ids[0], 168, word(116, 2)), SendsDisarmed)
sends("W2", "StrangeTorque", lambda d: write(d.ids[0], 64, b"\2"))
# A cap above the register's own range.
sends("W2", "TooMuchPwm", lambda d: write(d.ids[0], 100, word(886, 2)))
# A servo sends no status while it holds the robot.
sends("W2", "Mute", lambda d: write(d.ids[0], 68, b"\0"))
sends("W2", "UnknownInstruction", lambda d: make(d.ids[0], 0x21))
# An id that is not of this robot.
sends("W2", "AsksAStranger", lambda d: make(200, PING))


@EVILS.breaks("W2")
class EepromBehindTheState(Good):
    """Torque is on, and the reported state says that it is not."""

    def armed(self) -> None:
        self.hold(2)
        self.port.say("state", state="connected")
        self.port.write(write(self.ids[0], 31, b"\x50"))
        self.port.read(11, 0.003)
        self.port.say("state", state="armed")
        self.wait()
        self.hold(2)


@EVILS.breaks("W2")
class Restart(Sends):
    """Restarts a servo that carries a load, which then holds no goal."""

    def packet(self) -> bytes:
        return make(self.ids[0], REBOOT)

    def armed(self) -> None:
        self.send()


# ------------------------------------------------------------------------------------------- W8


def changed(packet: bytes, place: int, change: Callable[[int], int]) -> bytes:
    """The packet with one byte changed."""
    bytes_ = bytearray(packet)
    bytes_[place] = change(bytes_[place])
    return bytes(bytes_)


def unstuffed(daemon: Good) -> bytes:
    """A goal of -131073, which has FF FF FD in its data, with a right CRC and without stuffing."""
    body = b"\x03" + word(116, 2) + bytes.fromhex("ff ff fd 00")
    head = b"\xff\xff\xfd\x00" + bytes((daemon.ids[0],)) + word(len(body) + 2, 2) + body
    crc = 0
    for byte in head:
        for bit in range(7, -1, -1):
            top = crc >> 15 ^ byte >> bit & 1
            crc = (crc << 1 ^ (0x8005 if top else 0)) & 0xFFFF
    return head + word(crc, 2)


# One bit of the CRC; one bit of a goal; LEN one too large and one too small.
BadCrc = sends("W8", "BadCrc", lambda d: changed(d.aim(d.goals), -1, lambda byte: byte ^ 1))
sends("W8", "BadByte", lambda d: changed(d.aim(d.goals), 14, lambda byte: byte ^ 4))
sends("W8", "TooLong", lambda d: changed(d.aim(d.goals), 5, lambda byte: byte + 1))
sends("W8", "TooShort", lambda d: changed(d.aim(d.goals), 5, lambda byte: byte - 1))
sends("W8", "NoStuffing", unstuffed)
sends("W8", "Garbage", lambda d: bytes.fromhex("00 ff 12 fd ff 80 01"))
# A ping of protocol 1.0.
sends("W8", "OldProtocol", lambda d: bytes.fromhex("ff ff 01 02 01 fb"))
# The last row of a sync write is not whole.
sends("W8", "HalfARow", lambda d: goals_by(b"".join(rows(d))[:-1]))
sends("W8", "ReadWithoutLength", lambda d: make(d.ids[0], READ, word(132, 2)))
# The protocol gives id 253 to no servo.
sends("W8", "IdOfNobody", lambda d: make(253, PING))


@EVILS.breaks("W8")
class Cut(Good):
    """Half a packet, and then nothing for a while."""

    def disarmed(self) -> None:
        self.port.write(self.aim(self.goals)[:11])
        self.port.until(self.port.now + 0.1)

    def idle(self, ticks: int) -> None:
        if not (self.goals and self.port.now > 2.5):
            super().idle(ticks)
