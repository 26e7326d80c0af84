"""Virtual serial bus: bytes from the host in, bytes of the servos out at their time.

Repeated requests take a short way: the same sync read, goals by sync write. All others go through the framer
to `instructions`. While a fault is ordered, replies take the long way, one by one.
"""

import math
from collections.abc import Callable, Sequence
from itertools import accumulate, groupby
from typing import Any

import numpy as np

from twind_drivers.dynamixel.crc import crc16
from twind_drivers.dynamixel.packet import (
    HEADER,
    PATTERN,
    Framer,
    Instruction,
    Packet,
    StatusErrorCode,
    fast_status,
    status,
)
from twind_drivers.virtual.dynamixel_motor_figures import stand_in
from twind_drivers.virtual.faulty_byte_stream import SerialAdapter
from twind_drivers.virtual.group_read import FastSyncReadGroup, SyncReadGroup
from twind_drivers.virtual.instruction_set import InstructionReplies, InstructionSet, ServoStatus
from twind_drivers.virtual.register_columns import NO_ID
from twind_drivers.virtual.serial_bus_faults import SerialBusFaults
from twind_drivers.virtual.servo_physics import ServoPhysics
from twind_drivers.virtual.shown_position_log import ShownPositionLog
from twind_drivers.virtual.uart_receiver import clash, misheard
from twind_drivers.virtual.virtual_sensor import VirtualSensor
from twind_drivers.virtual.virtual_serial_line import VirtualSerialLine
from twind_drivers.virtual.virtual_servos import BAUDS, ServoSpec, VirtualServos

REMEMBERED = 256  # requests
GOAL = np.dtype([("id", "u1"), ("ticks", "<i4")])  # one row of a sync write
Group = SyncReadGroup | FastSyncReadGroup


class VirtualBus(VirtualSerialLine):
    """m servos on one wire. Time (s) is an argument and never goes back."""

    kind = "dynamixel2"

    def __init__(
        self,
        name: str,
        servos: Sequence[ServoSpec],
        muscles: ServoPhysics,
        *,
        baud: int = 2_000_000,
        wire_timing: bool = True,
        now: float = 0.0,
        keep_goal: bool = True,
        adapter: SerialAdapter | None = None,
        seed: int = 0,
        made: Callable[..., VirtualServos] = VirtualServos,
        sensor: VirtualSensor | None = None,
    ) -> None:
        """Make the bus; `baud`: of the line; a servo with another baud register receives and sends nothing.

        `made`: constructor of the servos, with the arguments of `VirtualServos`.
        `sensor`: a sensor on the bus.
        """
        super().__init__(name, baud, wire_timing=wire_timing, adapter=adapter, seed=seed)
        self.servos = made(servos, muscles, now=now, keep_goal=keep_goal)
        self.sensor = sensor
        self.faults = SerialBusFaults(name, self.servos, self.wire, self._stream, sensor)
        self._framer = Framer(status=False, broken=True)
        self.group_reads: dict[bytes, Group] = {}
        self._goal_rows: dict[bytes, tuple[Any, Any] | None] = {}
        self._places: dict[int, list[int]] = {}  # id -> rows that listen
        self.instructions = InstructionSet(self.servos, self._places)
        self._epoch = -1
        self._goal_span = self.servos.registers.goal_span()
        self.line(baud)
        for bits in range(5, 11):  # else the first long reply waits milliseconds for its CRC tables
            crc16(bytes(1 << bits))

    @property
    def history(self) -> ShownPositionLog | None:
        """Ticks kept by `record`, in the order of `ids`."""
        return self.servos.history

    def ids(self) -> list[int]:
        """Return the ids of the servos, in the order of rows."""
        return [int(id) for id in self.servos.registers.ids()]

    def truth(self, now: float) -> list[dict[str, object]]:
        """Return the true state of each servo at `now`, independent of the bus: see `servo_ground_truth`."""
        self.advance(now)
        return truth(self.servos, now)

    def motor_stand_ins(self) -> dict[str, str]:
        """Return the models without motor figures, and the one whose figures they have."""
        found = {each.model: stand_in(each) for each in self.servos.memory.tables}
        return {model: other for model, other in found.items() if other is not None}

    def skip_time(self, seconds: float) -> None:
        """Skip time in which the servos do not run; their clock registers count it all the same."""
        self.servos.readings.origin -= seconds

    def receive(self, data: bytes, now: float) -> None:
        """Take bytes from the host, sent at `now`."""
        if self._stream.bent:
            data = self._stream.send(data, now)
        place = 0
        while place < len(data) and self.is_plugged:
            size = self._complete_packet_size(data, place)
            chunk = data[place : place + size] if size else data[place:]
            at = self.wire.schedule_request(len(chunk), now)
            if not (size and self._serve_known_packet(chunk, at)):
                for packet in self._framer.feed(chunk):
                    self._packet(packet, at, chunk)
            place += len(chunk)
        if self._stream.garbled and data:
            self._babel()

    def advance(self, now: float) -> None:
        """Let time pass without traffic: muscles, watchdogs, boots."""
        self.servos.advance(now)

    def line(self, baud: int) -> None:
        """Set the host's port to `baud`. Raises ValueError for an invalid rate."""
        if baud <= 0:
            raise ValueError(f"bus {self.name}: {baud} baud is not a rate")
        if baud != self.servos.baud:
            self.wire.baud = self.servos.baud = baud
            self.servos.invalidate_cache()

    # --------------------------------------------------------------------------------- the short way

    def _complete_packet_size(self, data: bytes, place: int) -> int:
        """Return the size of the whole packet that begins at `place`; 0: the framer must process it."""
        if len(self._framer) or not data.startswith(HEADER, place) or len(data) < place + 10:
            return 0
        size = (data[place + 5] | data[place + 6] << 8) + 7
        return size if size >= 10 and place + size <= len(data) else 0

    def _serve_known_packet(self, packet: bytes, at: float) -> bool:
        """Serve a packet that needs no parsing; False: the packet is not of that kind."""
        servos = self.servos
        servos.run_timers(at)
        self._recall()
        group = self.group_reads.get(packet)
        if group is not None and not self.faults.active:
            servos.feed(at)
            return self._answer_group(group, at)
        if packet[7] != Instruction.SYNC_WRITE or packet[8:12] != self._goal_span:
            return False
        if (len(packet) - 14) % 5 or packet.find(PATTERN, 8) >= 0:
            return False
        if crc16(packet[:-2]) != packet[-2] | packet[-1] << 8:
            return False
        plan = self._plan_goals(packet[12:-2:5])
        if plan is None:
            return False
        rows, here = plan
        servos.advance(at)
        servos.feed(at)
        servos.set_goals(np.frombuffer(packet, GOAL, (len(packet) - 14) // 5, 12)["ticks"][here], rows)
        return True

    def _recall(self) -> None:
        """Clear values computed before the servos changed."""
        full = max(len(self.group_reads), len(self._goal_rows)) > REMEMBERED
        if self.servos.epoch == self._epoch and not full:
            return
        self._epoch = self.servos.epoch
        self.group_reads.clear()
        self._goal_rows.clear()
        registers = self.servos.registers
        shadows = self.instructions.shadows
        hears = self.servos.listening & registers.hearing()
        self._places.clear()
        shadows.clear()
        for row, id in enumerate(registers.ids()):
            if hears[row]:
                self._places.setdefault(id, []).append(row)
        for row, id in enumerate(registers.shadows()):
            if hears[row] and id != NO_ID:
                shadows.setdefault(id, []).append(row)

    def _plan_goals(self, ids: bytes) -> tuple[Any, Any] | None:
        """Rows that a sync write names, and which of its own they are; None where an id is not unique."""
        if ids not in self._goal_rows:
            found = [(place, self._places[id]) for place, id in enumerate(ids) if id in self._places]
            single = len(set(ids)) == len(ids) and all(len(rows) == 1 for _, rows in found)
            single = single and self.instructions.shadows.keys().isdisjoint(ids)
            here = slice(None) if len(found) == len(ids) else np.array([place for place, _ in found], np.intp)
            rows = self.servos.registers.selection([rows[0] for _, rows in found])
            self._goal_rows[ids] = (rows, here) if single else None
        return self._goal_rows[ids]

    def _answer_group(self, group: Group, at: float) -> bool:
        """False when an answer needs stuffing: then it goes the long way."""
        if group.live:
            self.servos.settle(at, whole=group.live > 1)
        data = group.data()
        if data is None:
            return False
        self.wire.schedule_replies(group.ends, group.cuts, data)
        return True

    def _remember(self, packet: Packet, answers: InstructionReplies, chunk: bytes) -> None:
        """Keep a sync read that all of one row per id answered soundly, for the short way."""
        params = packet.params
        rows = [answer.row for answer in answers.statuses]
        ids = bytes(answer.id for answer in answers.statuses)
        sound = rows and not any(answer.error for answer in answers.statuses) and len(set(rows)) == len(rows)
        whole = chunk.startswith(HEADER) and len(chunk) == len(params) + 10
        if not (sound and whole and params[4:].startswith(ids) and self._talk(answers) == answers.statuses):
            return
        span = (int.from_bytes(params[:2], "little"), int.from_bytes(params[2:4], "little"))
        if answers.promised:
            asked = len(params) - 4
            self.group_reads[chunk] = FastSyncReadGroup(self.servos, self.wire, rows, ids, span, asked)
        elif len(ids) == len(params) - 4:
            self.group_reads[chunk] = SyncReadGroup(self.servos, self.wire, rows, ids, span)

    # --------------------------------------------------------------------------------- the long way

    def _packet(self, packet: Packet, at: float, chunk: bytes) -> None:
        servos = self.servos
        servos.advance(at)
        self._recall()
        if packet.intact:
            servos.feed(at)
        answers = self.instructions.execute_packet(packet, at)
        self._answer(answers)
        if self.sensor is not None and packet.intact:
            self._let_tell(self.sensor, packet)
        if packet.instruction in (Instruction.SYNC_READ, Instruction.FAST_SYNC_READ) and packet.intact:
            self._remember(packet, answers, chunk)
        elif packet.instruction not in (Instruction.PING, Instruction.READ) and packet.intact:
            servos.invalidate_cache()

    def _let_tell(self, sensor: VirtualSensor, packet: Packet) -> None:
        piece = sensor.answer(packet)
        if piece and self.faults.active:
            self.faults.speak([sensor.id], [sensor.return_delay], [piece], joint=False)
        elif piece:
            self.wire.schedule_replies(
                self.wire.ends([sensor.return_delay], [len(piece)]), [len(piece)], piece
            )

    def _talk(self, answers: InstructionReplies) -> list[ServoStatus]:
        return [each for each in answers.statuses if self.servos.registers.level(each.row) >= answers.level]

    def _answer(self, answers: InstructionReplies) -> None:
        talk = self._talk(answers)
        if not talk:
            return
        crowds = [list(each) for _, each in groupby(talk, lambda each: each.id)]
        delays = [min(self.servos.registers.delays([each.row for each in crowd])) for crowd in crowds]
        if answers.promised:
            delays[1:] = [0.0] * (len(crowds) - 1)
            pieces = self._chain(crowds, answers.promised)
        else:
            pieces = [self._at_once(crowd) for crowd in crowds]
        if self.faults.active:
            ids = [crowd[0].id for crowd in crowds]
            self.faults.speak(ids, delays, pieces, joint=bool(answers.promised))
        else:
            sizes = list(map(len, pieces))
            self.wire.schedule_replies(
                self.wire.ends(delays, sizes), list(accumulate(sizes)), b"".join(pieces)
            )

    def _error(self, answer: ServoStatus) -> int:
        return answer.error | int(self.servos.alert[answer.row])

    def _at_once(self, answers: Sequence[ServoStatus]) -> bytes:
        """Return one servo's status; for several with one id that send at once, the bytes received.

        Each begins after its own return delay, so they may overlap in part or not at all.
        """
        packets = [status(each.id, self._error(each), each.data) for each in answers]
        if len(packets) == 1:
            return packets[0]
        delays = self.servos.registers.delays([each.row for each in answers])
        return clash(list(zip(delays, packets, strict=True)), self.wire.baud)

    def _chain(self, crowds: Sequence[Sequence[ServoStatus]], promised: int) -> list[bytes]:
        """Return the bytes of each link of a joint (fast) answer; links with one id send at the same time.

        Every CRC is over the bytes received before, garbage of a collision included.
        """
        heard = b""
        pieces = []
        for crowd in crowds:
            blocks = [self._block(heard, promised, each) for each in crowd]
            pieces.append(
                blocks[0] if len(blocks) == 1 else clash([(0.0, b) for b in blocks], self.wire.baud)
            )
            heard += pieces[-1]
        return pieces

    def _block(self, before: bytes, promised: int, answer: ServoStatus) -> bytes:
        """Return one servo's part of a common reply, behind `before`; the first announces the whole LEN."""
        row = (self._error(answer), answer.id, answer.data)
        if not before:
            return fast_status([row], promised)[0]
        block = bytes(row[:2]) + answer.data
        return block + crc16(before + block).to_bytes(2, "little")

    def _babel(self) -> None:
        """Send "unknown instruction" from servos at another rate; the host receives it at its own."""
        servos = self.servos
        here = self.wire.baud
        for row, index in enumerate(servos["baud_rate"]):
            there = BAUDS[min(int(index), len(BAUDS) - 1)]
            if there != here and np.isinf(servos.power.boots_at[row]) and not servos.silenced[row]:
                noise = misheard(
                    status(servos.registers.id_of(row), StatusErrorCode.INSTRUCTION), there, here
                )
                self.wire.schedule_replies(self.wire.ends([0.0], [len(noise)]), [len(noise)], noise)


def truth(servos: VirtualServos, now: float) -> list[dict[str, object]]:
    """Return one dict per servo, in rows, as of `now` (s, the servos' own clock).

    position and goal in the register's frame (position unrounded); encoder in continuous ticks; velocity raw;
    torque, watchdog register, tripped. heard_ago: s since the last packet that it received; tripped_at: s of
    the last trip; trip_delay: s from the packet before it; None: never.
    """
    position = servos.muscles.position * servos.direction + servos.shift
    return [
        {
            "id": servos.registers.id_of(row),
            "position": float(position[row]),
            "encoder": float(servos.muscles.position[row]),
            "velocity": float(servos.muscles.velocity[row]),
            "goal": int(servos["goal_position"][row]),
            "torque": bool(servos["torque_enable"][row]),
            "watchdog": int(servos["bus_watchdog"][row]),
            "tripped": bool(servos.tripped[row]),
            "listening": bool(servos.listening[row]),
            "heard_ago": now - float(servos.heard_at[row]),
            "tripped_at": _number(servos.tripped_at[row]),
            "trip_delay": _number(servos.trip_delay[row]),
        }
        for row in range(len(servos.tripped))
    ]


def _number(value: float) -> float | None:
    return None if math.isnan(value) else float(value)
