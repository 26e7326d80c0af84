"""Damiao and CubeMars: the packed frame of position, velocity, stiffness, damping and torque."""

from tests.proof.busmon.can.acts import Act, MotorReply, field, forbidden, sized
from tests.proof.busmon.can.motors import Motor
from tests.proof.busmon.can.text import Frame, Malformed

REGISTERS = 0x7FF  # id of all register traffic of a Damiao
READ = 0x33
WRITE = 0x55
STORE = 0xAA
REFRESH = 0xCC
WATCHDOG = 9
MODE = 10
TICK = 50e-6  # s
SPECIAL = b"\xff" * 7
ON = 0xFC
OFF = 0xFD
ZERO = 0xFE
CLEAR = 0xFB
TORQUE_ON = 1  # status nibble; 0: off, from 8: an error
OTHER_MODES = (0x100, 0x200, 0x300)


class Mit:
    """The motors of both."""

    def __init__(self, motors: list[Motor]) -> None:
        self._by_id = {motor.id: motor for motor in motors}
        self._damiao = {motor.id: motor for motor in motors if motor.family == "damiao"}
        self._replies = {motor.reply: motor for motor in self._damiao.values()}

    # ------------------------------------------------------------------------- to them

    def command(self, frame: Frame) -> Act | None:
        """None: not to one of these. Raises Malformed."""
        if frame.extended:
            return None
        if frame.id == REGISTERS and self._damiao:
            return self._register(frame)
        for base in OTHER_MODES:
            if frame.id - base in self._damiao:
                return Act("wrong", frame.id - base, why=f"a goal of another mode (id {frame.id:x})")
        motor = self._by_id.get(frame.id)
        if motor is None:
            return None
        if frame.remote:
            raise Malformed(f"a remote frame to {motor.id}")
        data = sized(frame.data, 8, f"a command to {motor.id}")
        if data[:7] == SPECIAL and data[7] >= 0xF0:
            return self._special(motor, data[7])
        kp = (data[3] & 15) << 8 | data[4]
        kd = data[5] << 4 | data[6] >> 4
        push = field((data[6] & 15) << 8 | data[7], 12, motor.torque)
        rate = field(data[2] << 4 | data[3] >> 4, 12, motor.velocity)
        # A CubeMars answers commands alone, so it is asked by one that damps towards no speed; no field says
        # 0, the nearest is half a step off.
        asks = motor.family == "cubemars" and abs(rate) <= motor.velocity / 4000.0
        if not kp and (not kd or asks) and abs(push) <= motor.torque / 2000.0:
            return Act("limp", motor.id)
        return Act("goal" if kp else "soft", motor.id, data[0] << 8 | data[1], rate, push)

    def _special(self, motor: Motor, last: int) -> Act:
        if last == ZERO:
            raise forbidden("a new zero", motor.id)
        if last == CLEAR and motor.family == "damiao":
            return Act("clear", motor.id)
        if last in (ON, OFF):
            return Act("on" if last == ON else "off", motor.id)
        return Act("wrong", motor.id, why=f"special frame {last:02x}")

    def _register(self, frame: Frame) -> Act:
        data = sized(frame.data, 8, "register traffic")
        id = data[0] | data[1] << 8
        what = data[2]
        register = data[3]
        if id not in self._damiao:
            raise Malformed(f"register traffic to {id}, which is not of this bus")
        if what == STORE:
            raise forbidden("an order to store", id)
        if what in (READ, REFRESH):
            return Act("read" if what == READ else "ask", id)
        value = int.from_bytes(data[4:], "little")
        if what == WRITE and register == WATCHDOG:
            return Act("write", id, seconds=value * TICK)
        if what == WRITE and register in (7, 8):
            raise forbidden("another id", id)
        if what == WRITE and register == MODE and value == 1:
            return Act("set", id)
        return Act("wrong", id, why=f"register command {what:02x} of register {register} with {value}")

    # ------------------------------------------------------------------------- from them

    def reply(self, frame: Frame) -> MotorReply | None:
        """None: nothing that is known."""
        if frame.extended or frame.remote or len(frame.data) != 8:
            return None
        data = frame.data
        motor = self._replies.get(frame.id)
        if motor is not None:
            if data[0] == motor.id & 255 and data[1] <= 15 and data[2] in (READ, WRITE, STORE, REFRESH):
                return self._answer(motor, data)
            if data[0] & 15 != motor.id & 15:
                return None
            state = data[0] >> 4
            return MotorReply(motor.id, data[1] << 8 | data[2], state == TORQUE_ON, state > TORQUE_ON)
        motor = self._by_id.get(data[0])
        if motor is None or motor.family != "cubemars" or frame.id not in (0, motor.id):
            return None
        return MotorReply(motor.id, data[1] << 8 | data[2], None, data[7] != 0)

    def _answer(self, motor: Motor, data: bytes) -> MotorReply | None:
        if data[2] == READ and data[3] == WATCHDOG:
            return MotorReply(motor.id, seconds=int.from_bytes(data[4:], "little") * TICK)
        return None
