"""Transactor of a CAN bus: one transaction at a time, pending frames ahead of it, its deadline.

I/O goes through a `CanChannel`; time is an argument. It classifies unrequested frames (FOREIGN_TRAFFIC) and
detects a dead line. Frames without acknowledgement wait in the adapter, and must not leave when another node
returns: an arm would snap to its old goals (axol #311).
"""

from math import inf

import numpy as np

from twind_drivers.bus import Bools, Ints, PortError, PortErrorCause
from twind_drivers.can.actuator_group import ActuatorGroup, GroupFeedback, joined
from twind_drivers.can.can_cycle_budget import STANDARD, frame_bits
from twind_drivers.can.can_transaction import CanTransaction, PendingCanGoals
from twind_drivers.ports import channel as wire
from twind_drivers.ports.frame import BYTES, NOTHING, Frames

LATE = 1.0  # s after a missed reply during which a surplus frame counts as late, not as foreign
DEAD = 0.1  # s of silence of all actuators: their watchdogs have run out, so earlier goals are void
NAP = 0.00015  # s, shortest time between two receive calls: each costs CPU
# s by which the first receive call of a reply moves later or sooner, and at most. In two of three cases it
# then finds the whole reply: the time of adapters, USB frames and stuff bits is in no table.
LATER = 0.00006
SOONER = 0.00003
LATEST = 0.001
LEAST = frame_bits(6, stuffed=False)  # bits of the shortest reply


class CanTransactor:
    """Transactor of one bus.

    `goals` leave with the next cyclic request; `urgent` with the next write of any kind, and goals set before
    that are dropped. `urgent` is sent again if the queue is discarded before a reply shows that it has left.

    `epoch` counts the events that make all earlier goals void: a full port, a line that is off, silence of
    all actuators for 0.1 s. A dead line is purged and probed ten times a second; no goal leaves on it.

    `foreign` counts unrequested frames: of unknown devices, of another master, second replies. A reply of an
    actuator that missed one within the last second does not count.
    """

    def __init__(
        self, fleet: ActuatorGroup, channel: wire.CanChannel, *, bitrate: int, slack: float, rare_slack: float
    ) -> None:
        """Make the transactor; `slack`, `rare_slack` (s): time that a reply may take beyond its wire time.

        The first holds for the cyclic reading, the second for rare transactions.
        """
        self.fleet = fleet
        self.channel = channel
        self.name = fleet.name
        self.slack = slack
        self.rare_slack = rare_slack
        self._bit = 1.0 / bitrate  # s
        self._frame = frame_bits(extended=fleet.wide) / bitrate  # s, at most
        self.urgent: Frames = NOTHING
        self.goals: PendingCanGoals | None = None
        self._leaving: Frames = NOTHING  # urgent, sent; no reply has shown yet that it left
        self.sent = self.received = self.deadline = self.earliest = -inf  # s
        self.strays = 0  # bytes dropped in the present transaction
        self.foreign = 0  # frames; the reader resets it when it reports them
        self.epoch = 0
        self.left: Ints = np.zeros(len(fleet), np.int64)  # (m,) the last goals sent, counts ...
        self.commanded: Bools = np.zeros(len(fleet), np.bool_)  # ... and the actuators (m,) that got any
        self.asked: Bools = np.ones(len(fleet), np.bool_)  # (m,) not parked
        self.heard = GroupFeedback.nothing(len(fleet))  # feedback of the present transaction
        self.expect: Ints = np.zeros(len(fleet), np.int64)  # (m,) expected frames of it
        self.aside: GroupFeedback | None = None  # feedback received after the last one had ended
        self.spoke: Bools = np.zeros(len(fleet), np.bool_)  # (m,) with frames since the last sample
        self.exact = False  # the transaction brought one frame of each actuator and no other
        self.exchange: CanTransaction | None = None
        self._leaves: PendingCanGoals | None = None
        self._done = True
        self._busy = -inf  # s, time until which sent frames are on the wire
        self._frames: list[Frames] = []
        self._count = self._wanted = self._sent_frames = self._everything = 0
        self._looked = -1  # number of frames that `heard` was decoded from
        self._cyclic = self._first_look = False
        self._late = {True: 0.0, False: 0.0}  # s, of cyclic and of rare transactions: see `_learn`
        self._owed = np.full(len(fleet), -inf)  # (m,) s, time until which a missed reply may come late
        # Their heartbeats and supply reports count as feedback, too. A heartbeat wins arbitration.
        self._spontaneous: Bools = ~fleet.replies & (fleet.answers > 0)
        self._any_spontaneous = bool(self._spontaneous.any())
        self._none: Ints = np.zeros(len(fleet), np.int64)
        self._no_rows: Bools = np.zeros(len(fleet), np.bool_)
        for each in (self._none, self._no_rows):
            each.setflags(write=False)
        self._silent_since = inf  # s, first request since the last frame of any actuator
        self._purged = -inf
        self._errors = channel.condition.errors

    # --------------------------------------------------------------------------- state of the line

    def condition(self, now: float) -> wire.CanErrorState:
        """The controller's state; OFF too where no device replied for 0.1 s to requests (CAN_BUS_STATE)."""
        return wire.CanErrorState.OFF if self.dead(now) else self.channel.condition.line

    def dead(self, now: float) -> bool:
        """Return True if the controller is off the wire, or no device acknowledges or replies."""
        return self.channel.condition.line is wire.CanErrorState.OFF or now - self._silent_since >= DEAD

    def void(self) -> None:
        """Drop pending goals and begin a new epoch, in which earlier goals are void."""
        self.goals = None
        self.epoch = self.epoch + 1

    def span(self, exchange: CanTransaction, beside: int = 0) -> float:
        """Return the bus time (s) of a transaction, both ways, with `beside` further frames."""
        back = int(exchange.expect.sum()) + len(exchange.registers)
        back += 0 if exchange.acks is None else int(np.count_nonzero(exchange.acks))
        return (len(exchange.frames) + back + beside) * self._frame

    # --------------------------------------------------------------------------- the transaction

    def commanded_rows(self, now: float) -> Bools:
        """Return the actuators (m,) that the next request commands.

        None where an urgent order goes first, where the goals have expired, or on a dead line; the goals are
        then dropped.
        """
        goals = self.goals
        if goals is not None and (len(self.urgent) or self.dead(now) or now > goals.until):
            goals = self.goals = None
        return goals.rows if goals is not None else self._no_rows

    def send(self, exchange: CanTransaction, now: float, *, goals: bool = False, order: bool = False) -> None:
        """Begin a transaction: drop late frames of the last one, then send.

        `goals`: send pending goals ahead of it. `order`: send it on a dead line, too.

        Raises PortError. Kind OUTPUT_FULL: the queue was still full. It is purged, goals are dropped, and an
        urgent order is sent later.
        """
        self.exchange = None
        self._done = True
        self.strays = 0
        self._look_back(self.channel.receive(now), now)
        if self.dead(now):
            exchange = self._revive(exchange, now, order=order)
        lead, rows = self._lead(goals)
        expect = exchange.expect if rows is self._none else exchange.expect + rows * self.fleet.replies
        try:
            if len(lead) or len(exchange.frames):
                self.channel.send(joined([lead, exchange.frames]), now)
        except PortError as error:
            if error.kind is PortErrorCause.OUTPUT_FULL:
                self._requeue_urgent()
                self._excuse(now)
            else:
                self.void()
            raise
        if len(self.urgent):
            self._leaving = self.urgent
            self.urgent = NOTHING
        if self._leaves is not None:
            self._keep(self._leaves)
        self._begin(exchange, lead, expect, now, cyclic=goals)

    def _keep(self, goals: PendingCanGoals) -> None:
        """Record the goals that left."""
        np.copyto(self.left, goals.ticks, where=goals.rows)
        self.commanded |= goals.rows

    def _lead(self, goals: bool) -> tuple[Frames, Ints]:
        """Return the first frames: an urgent order, else the goals; and the commands per actuator (m,)."""
        self._leaves = None
        if len(self.urgent):
            self.goals = None
            to = self.fleet.commanded_rows(self.urgent)
            return self.urgent, np.bincount(to[to >= 0], minlength=len(self.fleet))
        found = self.goals if goals else None
        if found is None:
            return NOTHING, self._none
        self.goals = found if found.kept else None
        self._leaves = found
        return found.frames, found.rows.view(np.int8).astype(np.int64)

    def _revive(self, exchange: CanTransaction, now: float, *, order: bool) -> CanTransaction:
        """Purge a dead line, since no old frame may wait in it, and probe it ten times a second."""
        self.void()
        self._excuse(now)
        if order or len(self.urgent) or now - self._purged >= DEAD:
            self._purged = now
            self.channel.purge()
            self._requeue_urgent()
            return exchange
        return CanTransaction(NOTHING, self._none)

    def _excuse(self, now: float) -> None:
        """Permit late answers of all: an adapter may have kept unacknowledged frames, and send them later."""
        np.maximum(self._owed, now + LATE, out=self._owed)

    def _requeue_urgent(self) -> None:
        """Void the goals after the queue was discarded, and schedule a lost urgent order again."""
        self.void()
        if not len(self.urgent):
            self.urgent = self._leaving
        self._busy = -inf

    def _begin(
        self, exchange: CanTransaction, lead: Frames, expect: Ints, now: float, *, cyclic: bool
    ) -> None:
        self.exchange = exchange
        self.sent = now
        self.received = now
        self.expect = expect
        self._frames = []
        self._count = 0
        self._looked = -1
        self.exact = False
        self._sent_frames = len(lead) + len(exchange.frames)
        self._everything = int(expect.sum())  # frames of feedback, of the parked too
        whole = self.asked.all()
        self._wanted = self._everything if whole else int(expect[self.asked].sum())
        self._wanted += len(exchange.registers)
        if not self._sent_frames:
            self.heard = self.fleet.decode_frames(NOTHING)
        waits = self._wanted > 0 or exchange.waits
        self._done = not waits and not len(lead) and not len(exchange.frames)
        begin = max(now, self._busy)
        self._busy = begin + self._sent_frames * self._frame
        back = self._everything + len(exchange.registers)
        back += 0 if exchange.acks is None else int(np.count_nonzero(exchange.acks))
        self._cyclic = cyclic
        self._first_look = True
        slack = self.slack if cyclic else min(self.slack, self.rare_slack)
        self.deadline = self._busy + back * self._frame + (slack if waits else 0.0)
        if self._wanted:
            payload = 8 * (int(lead["size"].sum()) + int(exchange.frames["size"].sum()))
            least = STANDARD * self._sent_frames + payload + LEAST * self._wanted
            self.earliest = min(begin + least * self._bit + self._late[cyclic], self.deadline)
        else:
            self.earliest = -inf
        if waits and self._silent_since == inf:
            self._silent_since = now

    def feed(self, now: float) -> bool:
        """Process received frames; return True when the transaction is complete. Raises PortError."""
        if self._done or self.exchange is None:
            return True
        got = self.channel.receive(now)
        if len(got):
            self.received = now
            self._frames.append(got)
            self._count += len(got)
        if self._count >= self._wanted and (len(got) or now >= self.deadline):
            self._done = self._complete(self.exchange) and self._is_request_sent(now)
        if len(got) and self._wanted:
            self._learn(now)
        return self._done

    def _learn(self, now: float) -> None:
        """Set the time of the next receive call, and adapt the first one of the next transaction.

        It waits for all missing frames together, not for each.
        """
        late = self._late[self._cyclic]
        if self._first_look:
            step = -SOONER if self._done else LATER
            self._late[self._cyclic] = min(max(late + step, 0.0), LATEST)
        self._first_look = False
        if not self._done and self._count < self._wanted:
            rest = max(NAP, (self._wanted - self._count) * LEAST * self._bit)
            self.earliest = min(now + rest, self.deadline)

    def _is_request_sent(self, now: float) -> bool:
        """Return True if all sent frames have left: each has a reply, or the wire had time for all of them.

        Otherwise the transaction ends at that time: the next one would find the adapter busy.
        """
        if self.exact or len(self._decode().answers) + int(self.heard.count.sum()) >= self._sent_frames:
            return True
        self.deadline = min(self.deadline, self._busy + self._count * self._frame)
        return now >= self.deadline

    def end(self) -> CanTransaction | None:
        """End the transaction; its feedback stays in `heard` until the next one. Never raises."""
        exchange = self.exchange
        self.exchange = None
        self._done = True
        if exchange is not None and not self.idle:
            feedback = self._decode()
            if self.exact or self._exact(exchange, feedback):
                self._silent_since = inf
                self._leaving = NOTHING
                return exchange
            self.spoke |= feedback.count > 0
            self._judge(feedback, self._surplus(exchange, feedback), self.sent)
            self._owed[self._missing_replies(exchange, feedback)] = self.sent + LATE
            if feedback.count.any() or feedback.answers:
                self._silent_since = inf
                self._leaving = NOTHING
        return exchange

    @property
    def idle(self) -> bool:
        """Return True if this transaction sent nothing and received nothing."""
        return self._sent_frames == self._count == 0

    def _exact(self, exchange: CanTransaction, feedback: GroupFeedback) -> bool:
        """Return True for the healthy reading: one requested frame of each actuator and no other frame."""
        self.exact = (
            self._count == self._everything == len(feedback.count)
            and exchange.acks is None
            and not (feedback.answers or feedback.strangers or feedback.masters)
            and np.array_equal(feedback.count, self.expect)
            and not (self._any_spontaneous and self._unplaced(feedback).any())
        )
        return self.exact

    def _unplaced(self, feedback: GroupFeedback) -> Bools:
        """Return which actuators (m,) that report by themselves owe the position they were asked for.

        One whose position is no number is waited for until the deadline, as one that is silent.
        """
        return self._spontaneous & (self.expect > 0) & np.isnan(feedback.position)

    def _decode(self) -> GroupFeedback:
        if self._looked != self._count:
            self.heard = self.fleet.decode_frames(joined(self._frames))
            self._looked = self._count
            self.exact = False
        return self.heard

    def _complete(self, exchange: CanTransaction) -> bool:
        feedback = self._decode()
        if self._exact(exchange, feedback) and exchange.states is None:
            return True
        if (self.asked & ((feedback.count < self.expect) | self._unplaced(feedback))).any():
            return False
        if not exchange.registers <= _read_addresses(feedback):
            return False
        if exchange.acks is not None and (exchange.acks & ~self._spoke(feedback)).any():
            return False
        return exchange.states is None or not (exchange.states & (feedback.enabled < 0)).any()

    def _spoke(self, feedback: GroupFeedback) -> Bools:
        spoke = feedback.count > 0
        spoke[[each.row for each in feedback.answers]] = True
        return spoke

    # --------------------------------------------------------------------------- unrequested frames

    def _look_back(self, frames: Frames, now: float) -> None:
        """Process the frames that arrived after the end of the last transaction."""
        before = self._errors
        self._errors = self.channel.condition.errors
        self.strays += max(0, self._errors - before)
        self.aside = None
        if not len(frames):
            return
        feedback = self.aside = self.fleet.decode_frames(frames)
        self.spoke |= feedback.count > 0
        surplus = np.where(self.fleet.replies, feedback.count, 0)
        replying = self.fleet.replies & (feedback.count == 0)
        np.add.at(surplus, [each.row for each in feedback.answers if replying[each.row]], 1)
        self._judge(feedback, surplus, now)
        if feedback.count.any():
            self._silent_since = inf

    def _surplus(self, exchange: CanTransaction, feedback: GroupFeedback) -> Ints:
        """Return the number (m,) of unrequested frames of each actuator.

        Frames that a device sends by itself (ODrive) never count. A write may be acknowledged by a register
        reply, by feedback, or by both.
        """
        surplus = np.where(self.fleet.replies, np.maximum(feedback.count - self.expect, 0), 0)
        requested = {row for row, _ in exchange.registers}
        for each in feedback.answers:
            if each.row in requested:  # a value may come in both forms, or two in one frame (RobStride)
                surplus[each.row] = max(0, surplus[each.row] - 1)
            elif self.fleet.replies[each.row] and not feedback.count[each.row]:
                surplus[each.row] += 1
        if exchange.acks is not None:
            surplus[exchange.acks] = 0
        return surplus

    def _missing_replies(self, exchange: CanTransaction, feedback: GroupFeedback) -> Bools:
        """Return the actuators (m,) that may still answer: incomplete ones, and those written to."""
        short: Bools = feedback.count < self.expect
        found = _read_addresses(feedback)
        short[[row for row, address in exchange.registers if (row, address) not in found]] = True
        return short if exchange.acks is None else short | exchange.acks

    def _judge(self, feedback: GroupFeedback, surplus: Ints, now: float) -> None:
        """Count frames of unknown devices and other masters, and `surplus` (m,).

        A surplus frame of an actuator with a missed reply is late, not foreign.
        """
        owing = self._owed > now
        late = int(surplus[owing & self.asked].sum())
        foreign = feedback.strangers + feedback.masters + int(surplus[~owing].sum())
        self.foreign += foreign
        self.strays += BYTES * (foreign + late)


def _read_addresses(feedback: GroupFeedback) -> set[tuple[int, int]]:
    """Return row and address of each register value; the acknowledgement of a write is no value."""
    return {(each.row, each.address) for each in feedback.answers if not each.written}
