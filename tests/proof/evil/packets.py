"""Wrong packets: W2 what may not be written, W8 what is no packet."""

from tests.proof.evil.good import (
    ACTION,
    ALL,
    BULK_WRITE,
    CLEAR,
    FACTORY,
    PING,
    READ,
    REBOOT,
    REG_WRITE,
    WRITE,
    Good,
    make,
    word,
)
from tests.proof.evil.registry import breaks


class Sends(Good):
    """Sends something once, armed and standing still."""

    def packet(self) -> bytes:
        raise NotImplementedError

    def armed(self) -> None:
        self.port.write(self.packet())
        self.port.read(64, 0.004)
        self.wait()
        self.hold(2)


class SendsDisarmed(Sends):
    """The same, before arming."""

    def armed(self) -> None:
        """Not then."""

    def connected(self) -> None:
        self.port.write(self.packet())
        self.port.read(64, 0.004)
        self.wait()


def write(id: int, address: int, data: bytes) -> bytes:
    return make(id, WRITE, word(address, 2) + data)


@breaks("W2")
class WrongAddress(Sends):
    """One register beside the goal: the goal velocity's upper half."""

    def packet(self) -> bytes:
        return self.sync_write(106, dict.fromkeys(self.ids, b"\0\0"))


@breaks("W2")
class WrongLength(Sends):
    """Only the low half of a goal."""

    def packet(self) -> bytes:
        return self.sync_write(116, {id: word(goal & 0xFFFF, 2) for id, goal in self.goals.items()})


@breaks("W2")
class GoalVelocity(Sends):
    """A goal of another mode."""

    def packet(self) -> bytes:
        return self.all(104, word(40))


@breaks("W2")
class Eeprom(Sends):
    """An EEPROM register while armed; the servo refuses it, the daemon should not have asked."""

    def packet(self) -> bytes:
        return write(self.ids[0], 48, word(4095))


@breaks("W2")
class EepromBehindTheState(Good):
    """Torque is on, and the state says that it is not."""

    def armed(self) -> None:
        self.hold(2)
        self.port.say("state", state="connected")
        self.port.write(write(self.ids[0], 31, b"\x50"))
        self.port.read(11, 0.003)
        self.port.say("state", state="armed")
        self.wait()
        self.hold(2)


@breaks("W2")
class WritesOperatingMode(Sends):
    """Another mode in the middle of everything: the joint would drop."""

    def packet(self) -> bytes:
        return write(self.ids[1], 11, b"\x04")


@breaks("W2")
class NewId(SendsDisarmed):
    """Gives a servo another id."""

    def packet(self) -> bytes:
        return write(self.ids[0], 7, b"\x09")


@breaks("W2")
class WritesToBroadcastId(Sends):
    """One write to everybody, strangers included."""

    def packet(self) -> bytes:
        return write(ALL, 116, word(2048))


@breaks("W2")
class Restart(Sends):
    """Restarts a servo that carries something."""

    def packet(self) -> bytes:
        return make(self.ids[0], REBOOT)

    def armed(self) -> None:
        self.port.write(self.packet())
        self.port.read(11, 0.004)
        self.wait()


@breaks("W2")
class RestartOfAll(SendsDisarmed):
    """By broadcast."""

    def packet(self) -> bytes:
        return make(ALL, REBOOT)

    def connected(self) -> None:
        self.port.write(self.packet())
        self.port.until(self.port.now + 1.0)
        self.tick = self.port.now
        self.idle(2)


@breaks("W2")
class FactoryReset(SendsDisarmed):
    """Everything but id and rate."""

    def packet(self) -> bytes:
        return make(self.ids[0], FACTORY, b"\2")

    def connected(self) -> None:
        super().connected()
        self.port.until(self.port.now + 1.0)
        self.tick = self.port.now
        self.idle(2)


@breaks("W2")
class ClearsTurns(SendsDisarmed):
    """Drops the turn count."""

    def packet(self) -> bytes:
        return make(self.ids[0], CLEAR, bytes.fromhex("01 44 58 4c 22"))


@breaks("W2")
class UnknownId(Sends):
    """A goal for somebody who is not of this robot."""

    def packet(self) -> bytes:
        return self.aim(self.goals | {77: 2048})


@breaks("W2")
class IdTwice(Sends):
    """A servo is told two things at once."""

    def packet(self) -> bytes:
        rows = [bytes((id,)) + word(goal) for id, goal in self.goals.items()]
        return make(ALL, 0x83, word(116, 2) + word(4, 2) + b"".join([*rows, rows[0]]))


@breaks("W2")
class LateGoal(Sends):
    """A goal that is stored now and acts later."""

    def packet(self) -> bytes:
        return make(self.ids[0], REG_WRITE, word(116, 2) + word(self.goals[self.ids[0]]))


@breaks("W2")
class LateAction(Sends):
    """Whatever is stored acts now."""

    def packet(self) -> bytes:
        return make(ALL, ACTION)


@breaks("W2")
class Bulk(Sends):
    """A goal by bulk write, where nothing is kept in one place."""

    def packet(self) -> bytes:
        id = self.ids[0]
        return make(ALL, BULK_WRITE, bytes((id,)) + word(116, 2) + word(4, 2) + word(self.goals[id]))


@breaks("W2")
class IndirectAddress(SendsDisarmed):
    """Maps a register somewhere else, where nobody looks for it."""

    def packet(self) -> bytes:
        return write(self.ids[0], 168, word(116, 2))


@breaks("W2")
class StrangeTorque(Sends):
    """Torque enable := 2."""

    def packet(self) -> bytes:
        return write(self.ids[0], 64, b"\2")


@breaks("W2")
class TooMuchPwm(Sends):
    """A cap above the register's own range."""

    def packet(self) -> bytes:
        return write(self.ids[0], 100, word(886, 2))


@breaks("W2")
class Mute(Sends):
    """Makes a servo silent while it holds the robot."""

    def packet(self) -> bytes:
        return write(self.ids[0], 68, b"\0")


@breaks("W2")
class UnknownInstruction(Sends):
    def packet(self) -> bytes:
        return make(self.ids[0], 0x21)


@breaks("W2")
class AsksAStranger(Sends):
    """A ping to an id that is not of this robot."""

    def packet(self) -> bytes:
        return make(200, PING)


# ------------------------------------------------------------------------------------------- W8


@breaks("W8")
class BadCrc(Sends):
    """One bit of the CRC."""

    def packet(self) -> bytes:
        good = self.aim(self.goals)
        return good[:-1] + bytes((good[-1] ^ 1,))


@breaks("W8")
class BadByte(Sends):
    """One bit of a goal, under the CRC of the right one."""

    def packet(self) -> bytes:
        good = bytearray(self.aim(self.goals))
        good[14] ^= 4
        return bytes(good)


@breaks("W8")
class TooLong(Sends):
    """LEN one too large: what follows is swallowed."""

    def packet(self) -> bytes:
        good = bytearray(self.aim(self.goals))
        good[5] += 1
        return bytes(good)


@breaks("W8")
class TooShort(Sends):
    """LEN one too small."""

    def packet(self) -> bytes:
        good = bytearray(self.aim(self.goals))
        good[5] -= 1
        return bytes(good)


@breaks("W8")
class NoStuffing(Sends):
    """FF FF FD among the data, sent as it is: a goal of -131073."""

    def packet(self) -> bytes:
        body = b"\x03" + word(116, 2) + bytes.fromhex("ff ff fd 00")
        head = b"\xff\xff\xfd\x00" + bytes((self.ids[0],)) + word(len(body) + 2, 2) + body
        return head + word(self.crc(head), 2)

    @staticmethod
    def crc(data: bytes) -> int:
        value = 0
        for byte in data:
            for bit in range(7, -1, -1):
                top = value >> 15 ^ byte >> bit & 1
                value = (value << 1 ^ (0x8005 if top else 0)) & 0xFFFF
        return value


@breaks("W8")
class Garbage(Sends):
    """Bytes that are nothing."""

    def packet(self) -> bytes:
        return bytes.fromhex("00 ff 12 fd ff 80 01")


@breaks("W8")
class OldProtocol(Sends):
    """A ping of protocol 1.0."""

    def packet(self) -> bytes:
        return bytes.fromhex("ff ff 01 02 01 fb")


@breaks("W8")
class Cut(Sends):
    """Half a packet, and then nothing for a while."""

    def packet(self) -> bytes:
        return self.aim(self.goals)[:11]

    def disarmed(self) -> None:
        self.port.write(self.packet())
        self.port.until(self.port.now + 0.1)

    def armed(self) -> None:
        """Not then."""

    def idle(self, ticks: int) -> None:
        if not (self.goals and self.port.now > 2.5):
            super().idle(ticks)


@breaks("W8")
class HalfARow(Sends):
    """A sync write whose last row is not whole."""

    def packet(self) -> bytes:
        rows = b"".join(bytes((id,)) + word(goal) for id, goal in self.goals.items())
        return make(ALL, 0x83, word(116, 2) + word(4, 2) + rows[:-1])


@breaks("W8")
class ReadWithoutLength(Sends):
    def packet(self) -> bytes:
        return make(self.ids[0], READ, word(132, 2))


@breaks("W8")
class IdOfNobody(Sends):
    """Id 253 belongs to nobody."""

    def packet(self) -> bytes:
        return make(253, PING)
