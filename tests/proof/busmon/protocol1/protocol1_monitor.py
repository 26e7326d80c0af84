"""The monitor of a bus with packets of the first protocol: bytes in, violations of W1-W8, W10, W11 out.

Its servos have no watchdog: W7 asks only for a hold after silence. A goal may switch torque on, so that none
may go to a servo whose torque is off except while torque is switched on.
"""

from typing import Any

import numpy as np

from tests.proof.busmon.limits import Limits
from tests.proof.busmon.protocol1.protocol1_packets import (
    BROADCAST,
    NAMES,
    PING,
    REBOOT,
    Command,
    command,
    is_sound,
    position,
    size_of,
)
from tests.proof.busmon.serial_monitor import SerialMonitor
from tests.proof.busmon.violation import ALONE, SILENCE, Seen


class Protocol1Monitor(SerialMonitor):
    """One bus."""

    SIZE_OF = staticmethod(size_of)

    def __init__(self, limits: Limits, *, writes: bool = True, hearsay: float = 0.0) -> None:
        """`writes` False: a mirror or a simulation, which writes nothing (W10)."""
        super().__init__(limits, writes=writes, hearsay=hearsay)
        assert limits.registers is not None
        self.registers = limits.registers
        self._heard = b""
        self._asked: list[tuple[int, int, int]] = []  # id, address, size: answers that are due, in order
        self._open = np.zeros(len(self.servos.ids), np.bool_)  # the lock: what is written is stored
        self._aimed = np.full(len(self.servos.ids), -np.inf)  # s, when a goal went out last

    # --------------------------------------------------------------------------- what went by

    def answered(self, data: bytes, now: float) -> None:
        """Bytes from the servos; what is no answer to the last request is passed over."""
        self.answers += 1
        self.last.append(Seen(now, "<", data))
        self._heard += data
        at = self._heard.find(b"\xff\xff")
        while self._asked and at >= 0:
            whole = self._heard[at : at + self._asked[0][2] + 6]
            if len(whole) < self._asked[0][2] + 6:
                break
            taken = self._status(whole, now)
            at = self._heard.find(b"\xff\xff", at + (len(whole) if taken else 1))
        self._heard = self._heard[max(at, 0) :] if at >= 0 else b""

    def _status(self, whole: bytes, now: float) -> bool:
        """Take a status packet of one of those who are asked; False: it is none."""
        owed = [ask for ask in self._asked if ask[0] == whole[2] and ask[2] + 2 == whole[3]]
        if not owed or not is_sound(whole):
            return False
        id, address, size = owed[0]
        self._asked = self._asked[self._asked.index(owed[0]) + 1 :]
        row = self.servos.row.get(id)
        if row is None:
            return True
        self.servos.alert[row] = bool(whole[4])
        data = whole[5:-1]
        own = self.registers
        if address <= own.position and own.position + 2 <= address + size:
            place = position(own, data[own.position - address :])
            self.servos.at(now, np.array([row]), np.array([place]))
        if address <= own.torque < address + size:
            limp = data[own.torque - address] == 0
            self.servos.off[row] = limp and not self.servos.on[row]
            self.servos.lost[row] = limp and self.servos.on[row]
        if own.lock is not None and address <= own.lock < address + size:
            self._open[row] = data[own.lock - address] != own.locked
        return True

    def look(self, now: float) -> None:
        """Time has passed: rules about silence."""
        super().look(now)
        silent = now - self.packet_at > SILENCE and self.packet_at > -np.inf
        if silent and self.servos.on.any() and not self.words.silent:
            self.stopping.owe_hold(now, now - self.packet_at)

    # --------------------------------------------------------------------------- what is known from outside

    def take_report(self, what: str, now: float, **facts: Any) -> None:
        """See `Words.take_report`; what it means for bytes is done here."""
        self.look(now)
        self.words.take_report(what, now, **facts)
        if what == "estop":
            self.stopping.begin(str(facts.get("level", "settle")), facts.get("at", now), now)
        elif what in ("hold", "damp", "aborted", "state", "killed"):
            self.stopping.take_report(what, now, facts)
        elif what in ("born", "port"):
            self._rest = self._heard = b""
            self._asked = []
            self.packet_at = -np.inf
            self.servos.begun(now)
            self.stopping.clear()
        elif what == "blind":
            self.packet_at = now
        elif what == "talker":
            self._broken("W9", now, None, f"a second talker: {facts}")
        if what == "killed":
            self._rest_since = np.inf  # the packet in flight may stay unfinished

    # --------------------------------------------------------------------------- instruction packets

    def _packet(self, packet: bytes, now: float) -> None:
        self.last.append(Seen(now, ">", packet))
        self.sent_packets += 1
        self.packet_at = now
        if self.words.killed:
            self._broken("W11", now, None, f"a packet after the kill: {packet[:64].hex(' ')}")
        request = command(packet)
        if request.instruction not in self.registers.instructions:
            self._broken("W2", now, None, f"{NAMES[request.instruction]}, which these servos do not know")
            return
        self._heard = b""
        self._asked = [ask for ask in request.reads if ask[0] != BROADCAST]
        foreign = [id for id, *_ in (*request.rows, *request.reads) if id not in self.servos.row]
        if request.writes and self.words.may_write(now, request.name):
            self._write(request, now)
        elif foreign and request.instruction != PING:
            self._broken("W2", now, foreign[0], f"{request.name} of an id that is not of this bus")

    def _write(self, request: Command, now: float) -> None:
        if request.instruction == REBOOT:
            self._restart(request.rows[0][0], now)
            return
        goals: dict[int, int] = {}
        for id, address, data in request.rows:
            rows = self.servos.all.tolist() if id == BROADCAST else [self.servos.row.get(id, -1)]
            for row in rows:
                if row < 0:
                    self._broken("W2", now, id, f"{request.name} to an id that is not of this bus")
                elif self._permitted(row, address, data, now):
                    self._registers_written(row, address, data, goals, now)
        if goals:
            self._aim(goals, now)

    def _restart(self, id: int, now: float) -> None:
        row = self.servos.row.get(id, -1)
        if row < 0 or not self.words.at_rest:
            self._broken("W2", now, id, f"a reboot in state {self.words.state}")
        elif not (self.servos.off[row] or self.servos.alert[row]):
            self._broken("W2", now, id, "a reboot: torque is on, or nobody has read it off")
        else:
            servos = self.servos
            servos.on[row] = servos.known[row] = self._open[row] = False
            servos.off[row] = servos.anew[row] = True

    def _permitted(self, row: int, address: int, data: bytes, now: float) -> bool:
        """W2: which registers, and when."""
        own = self.registers
        id = self.servos.ids[row]
        written = range(address, address + len(data))
        if address < own.stored:
            if not self._open[row] and own.copies.issuperset(written):
                return True
            if self.words.state != "calibrating":
                text = f"register {address} is EEPROM, written in state {self.words.state}"
            elif not self.servos.off[row] or self.servos.on[row]:
                text = f"register {address} is EEPROM: torque is on, or nobody has read it off"
            else:
                return True
            self._broken("W2", now, id, text)
            return False
        fields = {at for first, size in own.ram.items() for at in range(first, first + size)}
        end = address + len(data)
        whole = all(first + size <= end for first, size in own.ram.items() if first in written)
        if not fields.issuperset(written) or address not in own.ram or not whole:
            self._broken("W2", now, id, f"{len(data)} bytes at {address}, which is no register of ours")
            return False
        return True

    def _registers_written(
        self, row: int, address: int, data: bytes, goals: dict[int, int], now: float
    ) -> None:
        own = self.registers
        if address <= own.goal and own.goal + 2 <= address + len(data):
            goals[row] = position(own, data[own.goal - address :])
        if own.lock is not None and address <= own.lock < address + len(data):
            self._open[row] = data[own.lock - address] != own.locked
        if address <= own.torque < address + len(data):
            self._torque(row, data[own.torque - address], now)

    # --------------------------------------------------------------------------- goals and torque

    def _aim(self, words: dict[int, int], now: float) -> None:
        """W1, W3, W4, W5, W6, W7 of the goals of one packet, by row."""
        servos = self.servos
        self.goal_packets += 1
        self.words.left(self._since)
        self.words.goal(now, servos.ids[next(iter(words))])
        anew = [row for row in words if servos.anew[row] or self._since - self._aimed[row] > ALONE]
        for row, word in words.items():
            self._goal(row, word, now)
        rows = list(words)
        goals = servos.goal.copy()
        goals[rows] = list(words.values())
        servos.aim(now, goals)
        servos.aimed_anew(anew, self._since)
        self._aimed[rows] = now
        servos.known[rows] = True
        servos.anew[rows] = servos.first[rows] = False
        self.stopping.goals(now)

    def _goal(self, row: int, word: int, now: float) -> None:
        servos = self.servos
        id = servos.ids[row]
        if not servos.lower[row] <= word <= servos.upper[row]:
            self._broken("W1", now, id, f"goal {word} outside {servos.lower[row]}..{servos.upper[row]}")
        if not servos.on[row] and self.words.state == "armed":
            self._broken("W4", now, id, "a goal to a servo without torque, which it may switch on")
        moved = abs(word - int(servos.goal[row]))
        fresh = not servos.known[row] or servos.anew[row] or servos.off[row]
        if not fresh and moved <= servos.step[row]:
            return
        here = servos.is_here(row, word, self._since)
        if not here and (fresh or servos.first[row]):
            where = servos.present(row, self._since)[:5]
            self._broken("W4", now, id, f"goal {word}, neither a step nor where it was read: {where}")
        elif not here:
            text = f"goal {word}, {moved} counts from {servos.goal[row]}, {servos.step[row]:.1f} allowed"
            self._broken("W3", now, id, text)

    def _torque(self, row: int, value: int, now: float) -> None:
        servos = self.servos
        id = servos.ids[row]
        if value == 0:
            servos.on[row] = False
            servos.off[row] = True
            self.stopping.let_go(now)
            return
        if value != 1:
            self._broken("W2", now, id, f"torque enable = {value}, which moves the zero of the servo")
            return
        self.words.torque(now, id)
        if not servos.known[row] or servos.anew[row]:
            self._broken("W4", now, id, "torque on, and no goal was written before")
        elif not servos.is_here(row, int(servos.goal[row]), self._since):
            where = servos.present(row, self._since)[:5]
            self._broken("W4", now, id, f"torque on with goal {servos.goal[row]}, read {where}")
        if self._open[row]:
            self._broken("W2", now, id, "torque on with an open lock: settings would be stored")
        servos.on[row] = True
        servos.first[row] = True
        servos.off[row] = servos.lost[row] = False
