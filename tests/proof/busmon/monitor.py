"""The monitor: bytes of both directions in, violations of W1-W11 out. Time is an argument; no I/O.

It receives what is not in the bytes (states, an e-stop, the end of the process) by `take_report`. A report
may come `hearsay` seconds after the bytes that it explains.
"""

from typing import Any

import numpy as np

from tests.proof.busmon import allowed
from tests.proof.busmon.answers import Ear
from tests.proof.busmon.limits import Limits
from tests.proof.busmon.packet import size_of
from tests.proof.busmon.requests import (
    ACTION,
    BULK_WRITE,
    REBOOT,
    REG_WRITE,
    SYNC_WRITE,
    WRITE,
    Parser,
    Request,
)
from tests.proof.busmon.search import STATE as SEARCHING
from tests.proof.busmon.search import Search
from tests.proof.busmon.serial_monitor import SerialMonitor
from tests.proof.busmon.violation import BARE, SILENCE, Seen

WATCHDOG = 5  # x 20 ms, the longest that counts as one
BITS = 10  # a byte on the wire

EARLY_AMONG = 30_000  # packets, of fewer the share is taken as of so many


class Monitor(SerialMonitor):
    """One bus."""

    SIZE_OF = staticmethod(size_of)

    def __init__(self, limits: Limits, *, writes: bool = True, hearsay: float = 0.0) -> None:
        """`writes` False: a mirror or a simulation, which writes nothing (W10)."""
        super().__init__(limits, writes=writes, hearsay=hearsay)
        self.parser = Parser(limits)
        self.ear = Ear()
        self.search = Search(limits, self.servos)
        self._alone = True
        self._stored: dict[int, tuple[int, bytes]] = {}  # reg writes
        # Of the packets, how many may seem early: where a port may keep bytes, their times here are not those
        # of the daemon. One that does not wait for answers is early with every packet.
        self.early_share = 0.0
        self.early = 0
        self._easy = False  # nothing is pending but whole goal packets in range and in step
        self._byte = BITS / limits.baud

    # --------------------------------------------------------------------------- what went by

    def sent(self, data: bytes, now: float, since: float | None = None) -> None:
        """Bytes to the servos; they left at `now`, or from `since` on: who stamps may be late."""
        self._alone = True
        super().sent(data, now, since)

    def answered(self, data: bytes, now: float) -> None:
        """Bytes from the servos."""
        self.answers += 1
        self.last.append(Seen(now, "<", data))
        blocks = self.ear.whole(data)
        if blocks is not None and self.ear.request is not None:
            if self.ear.request.reads.keys() == self.servos.row.keys():
                rows = self._rows(bytes(self.ear.request.reads))
                good = (blocks["err"] & 0x7F) == 0
                self.servos.alert[rows] = (blocks["err"] & 0x80) != 0
                whole = bool(good.all())
                self.servos.at(now, rows if whole else rows[good], blocks["position"][good])
                self._uniform(self.ear.request, data, now)
                return
            self.ear.bytes = 0
        for id, error, address, raw in self.ear.take(data):
            self._status(id, error, address, raw, now)

    def look(self, now: float) -> None:
        """Time has passed: rules about silence."""
        super().look(now)
        servos = self.servos
        if servos.on.any() and not self.words.silent:
            if now - self.packet_at > SILENCE and self.packet_at > -np.inf:
                self.stopping.owe_hold(now, now - self.packet_at)
            late = servos.bare < now - BARE
            if late.any():
                row = int(np.argmax(late))
                self._broken("W7", now, servos.ids[row], "torque without a watchdog")
                servos.bare[late] = np.inf

    # --------------------------------------------------------------------------- what is known from outside

    def take_report(self, what: str, now: float, **facts: Any) -> None:
        """See `Words.take_report`; what it means for bytes is done here."""
        self.look(now)
        self.words.take_report(what, now, **facts)
        self._easy = False
        if what == "estop":
            self.stopping.begin(str(facts.get("level", "settle")), facts.get("at", now), now)
        elif what in ("hold", "damp", "aborted", "state", "killed"):
            self.stopping.take_report(what, now, facts)
        elif what in ("born", "port"):
            self._rest = b""
            self.packet_at = -np.inf
            self.ear.ask(None, now)
            self.servos.begun(now)
            self.stopping.clear()
        elif what == "blind":
            self.packet_at = now
        elif what == "talker":
            self._broken("W9", now, None, f"a second talker: {facts}")
        elif what == "servos":
            self._at_rest(now, facts)
        if what == "killed":
            self._rest_since = np.inf  # the packet in flight may stay unfinished

    def _at_rest(self, now: float, facts: dict[str, Any]) -> None:
        """W11: what the servos themselves say after a kill. `velocity`, `trip_delay`: by id."""
        if not self.words.killed:
            return
        for id, velocity in facts.get("velocity", {}).items():
            if now - self.packet_at > 0.120 and not abs(velocity) <= 1:
                late = now - self.packet_at
                self._broken("W11", now, id, f"turns at {velocity} {late:.3f} s after the last packet")
        for id, delay in facts.get("trip_delay", {}).items():
            if delay is None or not delay <= 0.120:
                self._broken("W11", now, id, f"its watchdog tripped {delay} s after the last packet")

    # --------------------------------------------------------------------------- instruction packets

    def _packet(self, packet: bytes, now: float) -> None:
        self.last.append(Seen(now, ">", packet))
        self.sent_packets += 1
        if self.words.killed:
            self._broken("W11", now, None, f"a packet after the kill: {packet[:64].hex(' ')}")
        self._overlap(now)
        request = self.parser.take(packet)
        self.packet_at = now
        if request.writes:
            if self.words.may_write(now, request.name):
                self._write(request, now)
            if request.expected:
                self.ear.ask(request, self._since)
        else:
            if request.wrong:
                self._broken("W2", now, None, request.wrong)
            self.ear.ask(request, self._since)
        self._alone = self._alone and not request.expected

    def _overlap(self, now: float) -> None:
        """W9: nobody honest talks while the answer to the last question is on the wire."""
        ear = self.ear
        if not self._alone and self._since < now:
            return  # a late stamp: when the packets of one chunk left, nobody knows
        if not ear.done and ear.request is not None and now - ear.asked < ear.request.expected * self._byte:
            self.early += 1
            if self.early <= self.early_share * max(self.sent_packets, EARLY_AMONG):
                return
            waited = (now - ear.asked) * 1e3
            text = f"a packet {waited:.2f} ms after a {ear.request.name} whose answer takes longer"
            self._broken("W9", now, None, text)

    def _write(self, request: Request, now: float) -> None:
        wrong = request.wrong or self._untimely(request)
        if wrong:
            self._broken("W2", now, request.id, wrong)
            if request.instruction not in (BULK_WRITE, REG_WRITE, ACTION):
                return
        if request.goals is not None:
            self._goals(self.servos.all, request.goals, now)
        elif request.instruction in (WRITE, SYNC_WRITE, BULK_WRITE):
            self._rows_written(request.rows, now)
        elif request.instruction == REG_WRITE:
            self._stored |= {id: (address, data) for id, address, data in request.rows}
        elif request.instruction == ACTION:
            due = {id: row for id, row in self._stored.items() if request.id in (id, 254)}
            self._rows_written([(id, *row) for id, row in due.items()], now)
            self._stored = {id: row for id, row in self._stored.items() if id not in due}
        elif request.instruction == REBOOT:
            self._restarted(self.servos.row[request.id])

    def _untimely(self, request: Request) -> str:
        """W2: what may be written only without torque."""
        if not (request.eeprom or request.quiet or request.instruction == REBOOT):
            return ""
        servos = self.servos
        ids = [id for id, _, _ in request.rows] or [request.id]
        rows = [servos.row[id] for id in ids if id in servos.row]
        if request.eeprom and self.words.state != "calibrating":
            return f"EEPROM is written in state {self.words.state}"
        if request.instruction == REBOOT and not self.words.restarts:
            return f"a reboot in state {self.words.state}"
        limp = servos.off[rows] & ~servos.on[rows]
        if request.instruction == REBOOT:
            limp |= servos.alert[rows]
        return "" if limp.all() else f"{request.name}: torque is on, or nobody has read it off"

    def _rows_written(self, rows: list[tuple[int, int, bytes]], now: float) -> None:
        servos = self.servos
        known = [(servos.row[id], address, data) for id, address, data in rows if id in servos.row]
        goals = [(row, data) for row, address, data in known if address == allowed.GOAL and len(data) == 4]
        if goals:
            words = [int.from_bytes(data, "little", signed=True) for _, data in goals]
            self._goals(np.array([row for row, _ in goals]), np.array(words, np.int64), now)
        for row, address, data in known:
            self.search.written(row, address, data)
            if address <= allowed.TORQUE < address + len(data):
                self._torque(row, data[allowed.TORQUE - address], now)
            if address <= allowed.WATCHDOG < address + len(data):
                self._watchdog(row, data[allowed.WATCHDOG - address], now)

    def _restarted(self, row: int) -> None:
        servos = self.servos
        servos.on[row] = servos.known[row] = servos.proved[row] = False
        servos.off[row] = servos.anew[row] = True
        servos.watchdog[row] = 0
        self._easy = False

    # --------------------------------------------------------------------------- goals, torque, watchdogs

    def _goals(self, rows: np.ndarray, words: np.ndarray, now: float) -> None:
        """W1, W3, W4, W5, W6, W7 of goals for `rows`."""
        servos = self.servos
        self.goal_packets += 1
        self.words.left(self._since)
        if self._easy and self.stopping.easy and rows is servos.all:
            move = np.abs(words - servos.goal)
            if not ((words < servos.lower) | (words > servos.upper) | (move > servos.step)).any():
                servos.aim(now, words)
                return
        if self.words.state == SEARCHING:
            self._search_goals(rows, now, "a goal")
        else:
            self.words.goal(now, servos.ids[int(rows[0])])
        anew = rows[servos.anew[rows]]
        for row, word in zip(rows.tolist(), words.tolist(), strict=True):
            self._goal(row, word, now)
        goals = servos.goal.copy()
        goals[rows] = words
        servos.aim(now, goals)
        servos.aimed_anew(anew.tolist(), self._since)
        servos.known[rows] = True
        servos.anew[rows] = servos.first[rows] = False
        self.stopping.goals(now)
        pending = not servos.known.all() or servos.anew.any() or servos.first.any() or not servos.on.all()
        self._easy = not pending and self.words.easy and self.stopping.easy

    def _goal(self, row: int, word: int, now: float) -> None:
        servos = self.servos
        id = self.servos.ids[row]
        lower = int(servos.lower[row])
        upper = int(servos.upper[row])
        if self.words.state == SEARCHING:
            rule, _, text = self.search.goal(row, word, now).partition(" ")
            if rule:
                self._broken(rule, now, id, text)
            if rule or not (servos.anew[row] or servos.first[row] or servos.off[row]):
                return
        elif not lower <= word <= upper:
            self._broken("W1", now, id, f"goal {word} outside {lower}..{upper}")
        before = int(servos.goal[row])
        moved = abs(word - before)
        if servos.first[row]:
            if moved > 2 and not servos.is_here(row, word, self._since):
                self._broken("W4", now, id, f"first goal after torque-on {word}, it was {before}")
            return
        if servos.known[row] and not servos.anew[row] and moved <= servos.step[row]:
            return
        if not servos.known[row] or servos.anew[row] or servos.off[row]:
            if not servos.is_here(row, word, self._since):
                rule = "W3" if servos.known[row] else "W4"
                where = servos.present(row, self._since)[:5]
                text = f"goal {word}, neither a step from {before if servos.known[row] else None}"
                self._broken(rule, now, id, f"{text} nor where it was read: {where}")
            return
        self._broken(
            "W3", now, id, f"goal {word}, {moved} counts from {before}, {servos.step[row]:.1f} allowed"
        )

    def _torque(self, row: int, value: int, now: float) -> None:
        servos = self.servos
        id = self.servos.ids[row]
        self._easy = False
        if not value:
            servos.on[row] = False
            servos.off[row] = True
            servos.bare[row] = np.inf
            self.stopping.let_go(now)
            return
        if self.words.state == SEARCHING:
            self._search_goals(np.array([row]), now, "torque on")
        else:
            self.words.torque(now, id)
        if not servos.known[row] or servos.anew[row]:
            self._broken("W4", now, id, "torque on, and no goal was written before")
        elif not servos.is_here(row, int(servos.goal[row]), self._since):
            where = servos.present(row, self._since)[:5]
            self._broken("W4", now, id, f"torque on with goal {servos.goal[row]}, read {where}")
        if not 1 <= servos.watchdog[row] <= WATCHDOG or not servos.proved[row]:
            state = f"written {servos.watchdog[row]}, read back {bool(servos.proved[row])}"
            self._broken("W7", now, id, f"torque on, and its watchdog is {state}")
        servos.on[row] = True
        servos.off[row] = False
        servos.first[row] = True
        servos.lost[row] = False

    def _search_goals(self, rows: np.ndarray, now: float, what: str) -> None:
        """W5 while nobody is armed: only what finds a stop."""
        for row in rows.tolist():
            if wrong := self.search.wrong(row):
                self._broken("W5", now, self.servos.ids[row], f"{what} in state {SEARCHING}, {wrong}")
                return

    def _watchdog(self, row: int, value: int, now: float) -> None:
        servos = self.servos
        servos.watchdog[row] = value
        servos.proved[row] = False
        self._easy = False
        if value > WATCHDOG and servos.on[row]:
            self._broken("W7", now, servos.ids[row], f"its watchdog is {value} x 20 ms under torque")
        if value == 0:
            servos.anew[row] = True  # a tripped servo takes goals again: the next is where it is
        servos.bare[row] = now if value == 0 and servos.on[row] else np.inf

    # --------------------------------------------------------------------------- answers

    def _rows(self, ids: bytes) -> np.ndarray:
        if ids == self.parser.ids:
            return self.servos.all
        return np.array([self.servos.row[id] for id in ids])

    def _uniform(self, request: Request, data: bytes, now: float) -> None:
        """Registers beside the position in a joint answer; the cyclic reading has none of interest."""
        address, size = next(iter(request.reads.values()))
        if address <= allowed.WATCHDOG:
            for number, id in enumerate(request.reads):
                at = 8 + number * (size + 4)
                self._registers(self.servos.row[id], address, data[at + 2 : at + 2 + size])

    def _status(self, id: int, error: int, address: int, data: bytes, now: float) -> None:
        row = self.servos.row.get(id)
        if row is None:
            return
        self.servos.alert[row] = bool(error & 0x80)
        if error & 0x7F:
            return
        if address <= 132 and address + len(data) >= 136:
            place = int.from_bytes(data[132 - address : 136 - address], "little", signed=True)
            self.servos.at(now, np.array([row]), np.array([place]))
        self._registers(row, address, data)

    def _registers(self, row: int, address: int, data: bytes) -> None:
        servos = self.servos
        end = address + len(data)
        self.search.read(row, address, data)
        if address <= allowed.TORQUE < end:
            limp = data[allowed.TORQUE - address] == 0
            servos.off[row] = limp and not servos.on[row]
            servos.lost[row] = limp and servos.on[row]
        if address <= allowed.WATCHDOG < end:
            servos.proved[row] = data[allowed.WATCHDOG - address] == servos.watchdog[row]
