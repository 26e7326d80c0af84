"""The monitor of a CAN bus: text of both directions in, violations of W1-W8, W10 and W11 out.

The rules are those of the serial bus, in terms of frames: a goal is a position field, torque is an enable
frame, a watchdog is a register of each motor, and each motor must hear from us by itself (W7).
"""

from collections import deque
from typing import Any

import numpy as np

from tests.proof.busmon.can.acts import Act, MotorReply
from tests.proof.busmon.can.mit import Mit
from tests.proof.busmon.can.motors import CanLimits
from tests.proof.busmon.can.odrive import ODrive
from tests.proof.busmon.can.robstride import RobStride
from tests.proof.busmon.can.text import Frame, Lines, Malformed, frame, set_up
from tests.proof.busmon.shadow import Servos
from tests.proof.busmon.stopping import Stopping
from tests.proof.busmon.violation import ALONE, BARE, KEPT, MOST, SILENCE, UNFINISHED, Seen, Violation
from tests.proof.busmon.words import Words

LONGEST = 0.1  # s, the longest watchdog that counts as one
PROBE = 0x7F0  # an id that nobody has: who acknowledges it is there
WRITES = frozenset(("goal", "soft", "limp", "on", "off", "clear", "write", "set", "stiffen", "wrong"))
ROUNDED = 1e-9


class CanMonitor:
    """One bus."""

    def __init__(self, limits: CanLimits, *, writes: bool = True, hearsay: float = 0.0) -> None:
        """`writes` False: a mirror or a simulation, which writes nothing (W10)."""
        # type: ignore[arg-type]
        self.limits = limits
        self.servos = Servos(limits)
        self.motors = [limits.servos[id] for id in self.servos.ids]
        self.servos.step += np.array([motor.slack for motor in self.motors])
        of = {
            name: [motor for motor in self.motors if motor.family in names]
            for name, names in (
                ("mit", ("damiao", "cubemars")),
                ("robstride", ("robstride",)),
                ("odrive", ("odrive",)),
            )
        }
        self.families = (Mit(of["mit"]), RobStride(of["robstride"]), ODrive(of["odrive"]))
        self.violations: list[Violation] = []
        self.last: deque[Seen] = deque(maxlen=KEPT)
        self.sent_packets = self.answers = self.goal_packets = 0
        self.words = Words(self._broken, writes=writes, hearsay=hearsay)
        self.stopping = Stopping(self._broken, limits, self.servos)  # type: ignore[arg-type]
        self._out = Lines()
        self._in = Lines()
        self._rest_since = self._since = self.packet_at = -np.inf
        self._fed = np.full(len(self.motors), -np.inf)  # s, when each was last spoken to
        self._void: list[int] = []  # rows whose goal in this text does not count
        self._aimed = np.full(len(self.motors), -np.inf)  # s, of its last goal
        self._goals: dict[int, int] = {}  # of the text that is being read

    def _broken(self, rule: str, time: float, id: int | None, text: str) -> None:
        if len(self.violations) < MOST:
            self.violations.append(Violation(rule, time, id, text))

    # --------------------------------------------------------------------------- what went by

    def sent(self, data: bytes, now: float, since: float | None = None) -> None:
        """Text to the adapter; it left at `now`, or from `since` on: who stamps may be late."""
        self._since = now if since is None else since
        self.look(now)
        if self.words.stopped:  # it runs again: its silence is over, and counts
            self.words.stopped = False
            self.look(now)
        self.last.append(Seen(now, ">", data))
        if self.words.killed:
            self._broken("W11", now, None, f"text after the kill: {data[:64]!r}")
        began = not self._out.rest
        lines = self._out.take(data)
        if lines or began:
            self._rest_since = now
        for line in lines:
            self._line(line, now)
        self._aim(now)
        self.packet_at = now

    def _line(self, line: bytes, now: float) -> None:
        try:
            if set_up(line, self.limits.baud):
                return
            self.sent_packets += 1
            self._frame(frame(line), now)
        except Malformed as wrong:
            self._broken("W8", now, None, str(wrong))

    def _frame(self, one: Frame, now: float) -> None:
        for family in self.families:
            act = family.command(one)
            if act is not None:
                self._act(act, now)
                return
        if not (one.id == PROBE and not one.extended and not any(one.data)):
            raise Malformed(f"a frame to id {one.id:x}, which is not of this bus")

    def answered(self, data: bytes, now: float) -> None:
        """Text from the adapter. What is no frame of a motor is passed over."""
        self.answers += 1
        self.last.append(Seen(now, "<", data))
        for line in self._in.take(data):
            try:
                one = frame(line)
            except Malformed:
                continue
            for family in self.families:
                reply = family.reply(one)
                if reply is not None:
                    self._take_reply(reply, now)

    def look(self, now: float) -> None:
        """Time has passed: rules about silence."""
        if self._out.rest and now - self._rest_since > UNFINISHED:
            self._broken("W8", now, None, f"a line that does not end: {self._out.rest[:64]!r}")
            self._out.rest = b""
        self.words.look(now)
        self.stopping.look(now)
        servos = self.servos
        if servos.on.any() and not self.words.silent:
            starved = servos.on & (now - self._fed > SILENCE + ROUNDED) & (self._fed > -np.inf)
            if starved.any():
                self.stopping.owe_hold(now, float((now - self._fed)[starved].max()))
            late = servos.bare < now - BARE
            if late.any():
                row = int(np.argmax(late))
                self._broken("W7", now, servos.ids[row], "torque without a watchdog")
                servos.bare[late] = np.inf

    # --------------------------------------------------------------------------- what is known from outside

    def take_report(self, what: str, now: float, **facts: Any) -> None:
        """See `Words.take_report`; what it means for frames is done here."""
        self.look(now)
        self.words.take_report(what, now, **facts)
        if what == "estop":
            self.stopping.begin(str(facts.get("level", "settle")), facts.get("at", now), now)
        elif what in ("hold", "damp", "aborted", "state", "killed"):
            self.stopping.take_report(what, now, facts)
        elif what in ("born", "port"):
            self._out = Lines()
            self._in = Lines()
            self.packet_at = -np.inf
            self._fed[:] = -np.inf
            self.servos.begun(now)
            self.stopping.clear()
        elif what == "blind":
            self._fed[self._fed > -np.inf] = now
        elif what == "servos":
            self._at_rest(now, facts)
        if what == "killed":
            self._rest_since = np.inf  # the frame in flight may stay unfinished

    def _at_rest(self, now: float, facts: dict[str, Any]) -> None:
        """W11: what the motors themselves say after a kill. `velocity` (words/s), by id."""
        late = now - self.packet_at
        for id, velocity in facts.get("velocity", {}).items():
            stops = self.motors[self.servos.row[id]].watched and self.words.killed and late > 0.120
            if stops and not abs(velocity) <= 1.0:
                self._broken("W11", now, id, f"turns at {velocity} {late:.3f} s after the last frame")

    # --------------------------------------------------------------------------- frames to motors

    def _act(self, act: Act, now: float) -> None:
        row = self.servos.row[act.id]
        self._fed[row] = now
        if act.kind not in WRITES:
            return
        if not self.words.may_write(now, act.kind):
            return
        if act.kind == "wrong":
            self._broken("W2", now, act.id, act.why)
        elif act.kind in ("goal", "soft"):
            self._fed_forward(row, act, now)
            if act.kind == "goal":
                self._goal(row, act, now)
        elif act.kind in ("on", "off"):
            self._aim(now)
            self._torque(row, act.kind == "on", now)
        elif act.kind == "write":
            self._watchdog(row, act.seconds, now)
        elif act.kind == "limp":  # its goal counts no more: the next one is where it is
            self.servos.anew[row] = True
        elif act.kind in ("clear", "set") and self._energised(row):
            self._broken("W2", now, act.id, f"{act.kind} under torque")

    def _energised(self, row: int) -> bool:
        """Torque was switched on, and the motor has not said since that it is off, or that it has a fault."""
        servos = self.servos
        return bool(servos.on[row] and not servos.lost[row] and not servos.alert[row])

    def _fed_forward(self, row: int, act: Act, now: float) -> None:
        """W2, W3, W5 of a command, whatever its place."""
        motor = self.motors[row]
        id = act.id
        self.words.left(self._since)
        self.words.goal(now, id)
        if not abs(act.rate) <= motor.rate * (1.0 + ROUNDED) + 2.0 * motor.velocity / 4095.0:
            self._broken("W3", now, id, f"{act.rate:.3f} rad/s fed forward, {motor.rate:.3f} allowed")
        if not abs(act.push) <= motor.push * (1.0 + ROUNDED) + 2.0 * motor.torque / 4095.0:
            self._broken("W2", now, id, f"{act.push:.3f} N·m fed forward, {motor.push:.3f} allowed")

    def _goal(self, row: int, act: Act, now: float) -> None:
        """W1, W3, W4 of the place of one goal."""
        servos = self.servos
        motor = self.motors[row]
        id = act.id
        self._goals[row] = act.word
        if not motor.lower <= act.word <= motor.upper:
            self._broken("W1", now, id, f"goal {act.word} outside {motor.lower}..{motor.upper}")
        before = int(servos.goal[row])
        moved = abs(act.word - before)
        if servos.first[row]:
            servos.first[row] = False
            if not servos.is_here(row, act.word, self._since):
                where = servos.present(row, self._since)[:5]
                self._broken("W4", now, id, f"first goal after torque-on {act.word}, read {where}")
        elif servos.known[row] and not servos.anew[row] and moved <= servos.step[row]:
            pass
        elif servos.lost[row]:  # it follows no goal, and one that is elsewhere does not count as its goal
            if not servos.is_here(row, act.word, self._since):
                self._void.append(row)
        elif not servos.known[row] or servos.anew[row] or not servos.on[row]:
            if not servos.is_here(row, act.word, self._since):
                where = servos.present(row, self._since)[:5]
                rule = "W3" if servos.known[row] else "W4"
                self._broken(rule, now, id, f"goal {act.word}, neither a step nor where it was read: {where}")
        else:
            step = servos.step[row]
            self._broken("W3", now, id, f"goal {act.word}, {moved} words from {before}, {step:.1f} allowed")

    def _aim(self, now: float) -> None:
        """All goals of one text are one step."""
        if not self._goals:
            return
        servos = self.servos
        rows = list(self._goals)
        goals = servos.goal.copy()
        goals[rows] = list(self._goals.values())
        new = np.array(
            [row in self._goals and (servos.anew[row] or not servos.known[row]) for row in servos.all]
        )
        servos.known[rows] = True
        servos.anew[rows] = False
        servos.anew[self._void] = True
        self._void = []
        self._goals = {}
        self.goal_packets += 1
        servos.goal = np.where(new, goals, servos.goal)  # where it is, and no step
        alone = [row for row in rows if not new[row] and self._since - self._aimed[row] > ALONE]
        servos.aim(now, goals)
        servos.aimed_anew(alone, self._since)
        self._aimed[rows] = now
        self.stopping.goals(now)

    def _torque(self, row: int, on: bool, now: float) -> None:
        servos = self.servos
        motor = self.motors[row]
        id = self.servos.ids[row]
        if not on:
            servos.on[row] = False
            servos.off[row] = True
            servos.bare[row] = np.inf
            self.stopping.let_go(now)
            return
        self.words.torque(now, id)
        if motor.family == "odrive":  # it has a goal that it turns to at once
            where = servos.present(row, self._since)[:5]
            if not servos.known[row] or servos.anew[row]:
                self._broken("W4", now, id, "torque on, and no goal was written before")
            elif not servos.is_here(row, int(servos.goal[row]), self._since):
                self._broken("W4", now, id, f"torque on with goal {servos.goal[row]}, read {where}")
        if motor.watched and not (0 < servos.watchdog[row] <= LONGEST * 1e6 and servos.proved[row]):
            state = f"{servos.watchdog[row]} us, read back {bool(servos.proved[row])}"
            self._broken("W7", now, id, f"torque on, and its watchdog is {state}")
        servos.on[row] = True
        servos.off[row] = False
        servos.lost[row] = False
        servos.first[row] = True

    def _watchdog(self, row: int, seconds: float, now: float) -> None:
        servos = self.servos
        servos.watchdog[row] = round(seconds * 1e6)
        servos.proved[row] = False
        if seconds > LONGEST + ROUNDED and servos.on[row]:
            self._broken("W7", now, servos.ids[row], f"its watchdog is {seconds} s under torque")
        servos.bare[row] = now if not seconds and servos.on[row] else np.inf

    # --------------------------------------------------------------------------- frames from motors

    def _take_reply(self, reply: MotorReply, now: float) -> None:
        servos = self.servos
        row = self.servos.row[reply.id]
        if reply.alert is not None:
            servos.alert[row] = reply.alert
        if reply.word is not None:
            servos.at(now, np.array([row]), np.array([reply.word]))
        if reply.on is not None and servos.on[row]:
            servos.lost[row] = not reply.on
        elif reply.on is not None:
            servos.off[row] = not reply.on
        if reply.seconds is not None:
            servos.proved[row] = round(reply.seconds * 1e6) == servos.watchdog[row]
