"""The writing half of a Dynamixel bus: goals, torque, registers. Exists in live only.

Every packet is judged by its own bytes before it leaves (R22): ids of this bus, writable addresses, goal
words inside the raw range.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from twind_drivers.bus import (
    Burst,
    DeviceRefused,
    Ints,
    NoReply,
    Order,
    Ping,
    Reboot,
    Register,
    Script,
    WireClamp,
    Write,
)
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.goals import GoalPacket
from twind_drivers.dynamixel.layout import Block
from twind_drivers.dynamixel.line import Exchange
from twind_drivers.dynamixel.reader import DynamixelReader
from twind_drivers.dynamixel.replies import PlainReply

BOOT_ATTEMPTS = 300  # pings after a reboot before we give up: 3 s at 100 Hz

# Registers that `write` leaves alone, and whose they are.
ELSEWHERE = {
    "torque_enable": "torque is switched by arming and disarming",
    "goal_position": "goals pass the gate",
    "goal_velocity": "goals pass the gate",
    "id": "it would answer under another id than this bus knows",
    "baud_rate": "it would answer at another baud rate than this bus has",
    "protocol_type": "it would no longer speak this protocol",
}


class Gains(NamedTuple):
    """Position loop gains, raw; None: the model's default."""

    p: int | None = None
    i: int | None = None
    d: int | None = None


class DynamixelWriter:
    """Writes to the bus of `reader`; arrays are in the order of its ids."""

    def __init__(
        self,
        reader: DynamixelReader,
        *,
        lower: Ints,
        upper: Ints,
        gains: Sequence[tuple[int | None, int | None, int | None]] | None = None,
        watchdog: int = 5,
    ) -> None:
        """`lower`, `upper` (m,): goals in ticks that may ever be sent. `gains` (m): P, I, D each;
        None: the models' defaults. `watchdog`: x 20 ms, 1..127.

        Raises ValueError: bounds of the wrong shape, watchdog off, a gain without a known default.
        """
        if not 1 <= watchdog <= 127:
            raise ValueError(f"{reader.name}: watchdog {watchdog} is outside 1..127 (x 20 ms)")
        self._reader, self._line, self._layout = reader, reader.line, reader.layout
        self._name, self._ids = reader.name, reader.ids
        self._goals = GoalPacket(reader.name, reader.ids, self._layout.goal, lower, upper)
        self._watchdog = bytes((watchdog,))
        each = [Gains()] * len(self._ids) if gains is None else [Gains(*one) for one in gains]
        self._gains = {id: self._gain_bytes(id, wanted) for id, wanted in zip(self._ids, each, strict=True)}
        self._off = packet.sync_write(self._layout.torque.address, dict.fromkeys(self._ids, b"\0"))

    # --------------------------------------------------------------------------- every tick

    def goals(self, ticks: Ints) -> None:
        """Goals (m,) for the next `request`. Raises WireClamp, ValueError; then nothing is pending."""
        self._line.goals = b""
        self._line.goals = self._goals.encode(ticks)

    def cut(self) -> None:
        """Torque off for all, twice, in the next write of any kind; goals given before it are not sent."""
        self._line.urgent, self._line.goals = self._off * 2, b""

    def clear(self) -> None:
        """Drop pending goals. A pending cut stays: torque off is never refused."""
        self._line.goals = b""

    # --------------------------------------------------------------------------- the rare path

    def begin(self, order: Order, now: float) -> None:
        """Begin one order; the reader's `answer` ends it. Raises PortError, WireClamp; TypeError."""
        exchange = self._exchange(order)
        self._judge(exchange.packet)
        self._line.send(exchange, now)

    def _exchange(self, order: Order) -> Exchange:
        if isinstance(order, Reboot):
            return Exchange(packet.reboot(order.id), PlainReply((order.id,), 0), 1)
        if isinstance(order, Write) and len(order.data) == 1:
            [(id, data)] = order.data.items()
            return Exchange(packet.write(id, order.address, data), PlainReply((id,), 0), 1)
        if isinstance(order, Write | Burst):
            writes = (order,) if isinstance(order, Write) else order.writes
            packets = b"".join(packet.sync_write(each.address, each.data) for each in writes)
            return Exchange(packets, None, 0)
        raise TypeError(f"{self._name}: a writer does not ask: {order}")

    def _judge(self, data: bytes) -> None:
        """What stands in the bytes: known ids, writable addresses, goal words inside their range."""
        framer = packet.Framer(status=False)
        found = framer.feed(data)
        if framer.discarded or len(framer) or not found:
            raise WireClamp(self._name, packet.BROADCAST, len(data), 0, 0, "stray bytes in a packet")
        for each in found:
            for id, address, raw in _rows(each):
                self._judge_row(id, address, raw)

    def _judge_row(self, id: int, address: int, raw: bytes) -> None:
        if id not in self._reader.tables:
            raise WireClamp(self._name, id, id, min(self._ids), max(self._ids), "address to id")
        goal = self._layout.goal
        if address < goal.address + goal.size and goal.address < address + len(raw):
            place = self._ids.index(id)
            lower, upper = int(self._goals.lower[place]), int(self._goals.upper[place])
            word = int.from_bytes(raw, "little", signed=True)
            if (address, len(raw)) != (goal.address, goal.size) or not lower <= word <= upper:
                raise WireClamp(self._name, id, word, lower, upper)
        writable = self._reader.tables[id].writable
        if not writable.issuperset(range(address, address + len(raw))):
            raise WireClamp(self._name, id, address, min(writable), max(writable), "read-only address")

    # --------------------------------------------------------------------------- scripts

    def prepare(self, ticks: Ints) -> Script[None]:
        """Before torque; each step read back from all. Raises DeviceRefused, NoReply, WireClamp.

        Watchdogs cleared, goal := `ticks` (m,), watchdogs armed, in one system call: a tripped servo whose
        torque is still on must not resume its old goal. Gains; profile 0 (the executor shapes the motion).
        """
        layout, goal = self._layout, self._goal_rows(ticks)
        watchdog = dict.fromkeys(self._ids, self._watchdog)
        yield Burst((self._all(layout.watchdog, b"\0"), goal, Write(watchdog, layout.watchdog.address)))
        yield from self._same("bus watchdog", layout.watchdog, watchdog)
        yield Burst((Write(self._gains, layout.gains.address), self._all(layout.profile, bytes(8))))
        yield from self._same("position gains", layout.gains, self._gains)
        motion = {id: bytes(8) + row for id, row in goal.data.items()}
        yield from self._same("profile and goal position", layout.motion, motion)

    def aim(self, ticks: Ints) -> Script[None]:
        """Write goals (m,) and read them back. Raises DeviceRefused on the first that differs, WireClamp."""
        goal = self._goal_rows(ticks)
        yield Burst((goal,))
        yield from self._same("goal position", self._layout.goal, goal.data)

    def aimed(self) -> Script[Ints]:
        """The goals (m,) that the devices hold now, in ticks. Raises NoReply."""
        goal = self._layout.goal
        found = yield from self._reader.collect(self._ids, goal.address, goal.size)
        words = b"".join(found[id] for id in self._ids)
        return np.frombuffer(words, "<i4").astype(np.int64)

    def torque(self, on: bool) -> Script[None]:
        """Torque of all, read back. Off is written twice. Raises DeviceRefused, NoReply."""
        order = self._all(self._layout.torque, bytes((on,)))
        yield Burst((order,) if on else (order, order))
        yield from self._same("torque enable", self._layout.torque, order.data)

    def write(self, id: int, name: str, value: int) -> Script[Register]:
        """One register by name, read back. EEPROM only while that device's torque is off.

        Raises NoReply, DeviceRefused, KeyError (lists near names), ValueError (range, read-only, not here).
        """
        table = self._reader.table(id)
        field = table[name]
        if field.key in ELSEWHERE:
            raise ValueError(f"{field.name} is not written here: {ELSEWHERE[field.key]}")
        field.check(value)
        if field.eeprom and (yield from self._reader.read(id, "torque_enable")).value:
            reason = "is EEPROM, writable only while torque is off: disarm first"
            raise DeviceRefused(self._name, id, field.name, reason)
        reply = yield Write({id: field.encode(value)}, field.address)
        error = reply.error.get(id, 0)
        if error & 0x7F:
            raise DeviceRefused(self._name, id, f"{field.name} = {value}", packet.explain(error))
        back = yield from self._reader.read(id, field.key)
        if back.value != value:
            raise DeviceRefused(self._name, id, field.name, f"wrote {value}, reads {back.value}")
        return back

    def reboot(self, id: int) -> Script[None]:
        """Restart one device and wait until it answers again. Raises NoReply, KeyError."""
        self._reader.table(id)
        reply = yield Reboot(id)
        if id not in reply.error:
            raise NoReply(self._name, (id,), reply.waited, "reboot")
        self._reader.slow.forget(id)
        waited = reply.waited
        for _ in range(BOOT_ATTEMPTS):
            reply = yield Ping(id)
            waited += reply.waited
            if id in reply.data:
                return
        raise NoReply(self._name, (id,), waited, f"{BOOT_ATTEMPTS} pings after a reboot")

    # --------------------------------------------------------------------------- parts

    def _all(self, block: Block, data: bytes) -> Write:
        return Write(dict.fromkeys(self._ids, data), block.address)

    def _goal_rows(self, ticks: Ints) -> Write:
        """Judged here too, so that a script's WireClamp is the script's."""
        self._goals.encode(ticks)
        words = ticks.astype("<i4")
        return Write({id: words[i].tobytes() for i, id in enumerate(self._ids)}, self._layout.goal.address)

    def _same(self, what: str, block: Block, wanted: Mapping[int, bytes]) -> Script[None]:
        found = yield from self._reader.collect(self._ids, block.address, block.size)
        for id, data in wanted.items():
            if found[id] != data:
                reason = f"wrote {data.hex(' ')}, reads {found[id].hex(' ')}{self._why(id)}"
                raise DeviceRefused(self._name, id, f"{what} ({block.address})", reason)

    def _why(self, id: int) -> str:
        """What the slow registers last said that explains a servo which does not obey."""
        place, state = self._ids.index(id), self._reader.registers
        if state.fault[place] > 0:
            return f"; hardware error {state.fault[place]:#04x} (register 70): find the cause, then reboot it"
        return "; its bus watchdog has tripped" if state.watchdog[place] == 255 else ""

    def _gain_bytes(self, id: int, gains: Gains) -> bytes:
        table = self._reader.table(id)
        parts = []
        for key, wanted in (("d", gains.d), ("i", gains.i), ("p", gains.p)):
            field = table[f"position_{key}_gain"]
            value = field.rule.default if wanted is None else wanted
            if value is None:
                raise ValueError(
                    f"{self._name}: id {id}: no default of {field.name} known for {table.model}: set it"
                )
            field.check(value)
            parts.append(field.encode(value))
        return b"".join(parts)


def _rows(found: packet.Packet) -> list[tuple[int, int, bytes]]:
    """(id, address, data) of each write in a packet; a restart writes nothing but names its id."""
    params = found.params
    if found.instruction == packet.Instruction.REBOOT:
        return [(found.id, 0, b"")]
    address = int.from_bytes(params[:2], "little")
    if found.instruction == packet.Instruction.WRITE:
        return [(found.id, address, params[2:])]
    size = int.from_bytes(params[2:4], "little") + 1
    rows = [params[at : at + size] for at in range(4, len(params), size)]
    return [(row[0], address, row[1:]) for row in rows]
