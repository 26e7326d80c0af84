"""One wire of frames: one transaction at a time, what is pending before it, its deadline.

I/O through a `CanChannel`; time is an argument. It judges unrequested frames (FOREIGN_TRAFFIC), and what
silence means: frames that nobody acknowledges wait in the adapter, and must not leave when somebody is back.
"""

from dataclasses import dataclass
from math import inf

import numpy as np

from twind_drivers.bus import Bools, Ints, OutputQueueFull, PortError
from twind_drivers.can import channel as wire
from twind_drivers.can.actuator_group import ActuatorGroup, GroupFeedback, joined
from twind_drivers.can.frame import BYTES, NOTHING, Frames

LATE = 1.0  # s that an answer may be late and is still known as one
DEAD = 0.1  # s without anybody: what the actuators' watchdogs are set to; whatever was given before is void
# of a frame of 8 bytes, stuffed as badly as can be ...
STANDARD_BITS = 135
EXTENDED_BITS = 160
NAP = 0.00015  # s at least between two looks at answers that are coming
# s by which the first look at an answer is moved where it came too soon, or not; and at most. So two looks of
# three find the answer whole: adapters, their USB frames, stuffed bits take a time that no table knows.
LATER = 0.00006
SOONER = 0.00003
LATEST = 0.001
# ... of a frame beside its payload, and of the shortest answer (6 bytes), not stuffed
AROUND = 47
LEAST = 95


@dataclass(frozen=True, slots=True)
class CanTransaction:
    """Frames to send, and what should come back. Arrays (m,)."""

    frames: Frames
    expect: Ints  # frames of feedback
    registers: frozenset[tuple[int, int]] = frozenset()  # row and address of each register that is asked for
    acks: Bools | None = None  # who must say anything at all: who was written to
    states: Bools | None = None  # who must say whether its torque is on

    @property
    def waits(self) -> bool:
        """Something should come back."""
        some = self.acks is not None or self.states is not None
        return some or bool(self.registers) or bool(self.expect.any())


@dataclass(slots=True)
class PendingCanGoals:
    """Commands that wait for the next cyclic request, and whom (m,) they command."""

    frames: Frames
    rows: Bools
    ticks: Ints  # (m,) where to
    until: float = inf  # s: not sent later than that
    kept: bool = False  # sent again with each request, until others come


class CanTransactor:
    """The wire of one bus.

    `goals` leave with the next cyclic request; `urgent` with the next write of any kind, and goals set before
    it left are dropped. Until an answer shows that it left, it is sent again when the queue was thrown away.

    `epoch` counts what makes every goal given before void: a full port, a line that is off, silence of
    everybody for 0.1 s. A dead line is purged, and asked ten times a second; no goal leaves on it.

    `foreign` counts frames that nobody asked for: of nobody here, of another master, second answers. An
    answer of an actuator that missed one within the last second is not among them.
    """

    def __init__(
        self, fleet: ActuatorGroup, channel: wire.CanChannel, *, bitrate: int, slack: float, rare_slack: float
    ) -> None:
        """`slack`, `rare_slack` (s): what an answer may take beyond its wire time."""
        self.fleet = fleet
        self.channel = channel
        self.name = fleet.name
        self.slack = slack
        self.rare_slack = rare_slack
        self._bit = 1.0 / bitrate  # s
        self._frame = (EXTENDED_BITS if fleet.wide else STANDARD_BITS) / bitrate  # s, at most
        self.urgent: Frames = NOTHING
        self.goals: PendingCanGoals | None = None
        self._leaving: Frames = NOTHING  # urgent, sent, and not yet known to have left
        self.sent = self.received = self.deadline = self.earliest = -inf  # s
        self.strays = 0  # bytes dropped in the present transaction
        self.foreign = 0  # frames; whoever reports it sets it back
        self.epoch = 0
        self.left: Ints = np.zeros(len(fleet), np.int64)  # the last goals that went out ...
        self.told: Bools = np.zeros(len(fleet), np.bool_)  # ... to whom any did
        self.asked: Bools = np.ones(len(fleet), np.bool_)  # whose answers are waited for
        self.heard = GroupFeedback.nothing(len(fleet))  # in the present transaction
        self.expect: Ints = np.zeros(len(fleet), np.int64)  # of it, urgent orders and goals included
        self.aside: GroupFeedback | None = None  # what came after the last one had ended, if anything
        self.spoke: Bools = np.zeros(len(fleet), np.bool_)  # who said anything since the last sample
        self.exact = False  # the transaction brought one frame of everybody, and nothing else
        self.exchange: CanTransaction | None = None
        self._leaves: PendingCanGoals | None = None
        self._done = True
        self._busy = -inf  # s, until when our own frames are still going out
        self._frames: list[Frames] = []
        self._count = self._wanted = self._sent_frames = self._everything = 0
        self._looked = -1  # frames that `heard` was made of
        self._cyclic = self._first_look = False
        self._late = {True: 0.0, False: 0.0}  # s, of the cyclic reading and of the others: see `_learn`
        self._owed = np.full(len(fleet), -inf)  # s, until when an answer may still come late
        self._none: Ints = np.zeros(len(fleet), np.int64)
        self._nobody: Bools = np.zeros(len(fleet), np.bool_)
        for each in (self._none, self._nobody):
            each.setflags(write=False)
        self._silent_since = inf  # s, of the first question since anybody was heard
        self._purged = -inf
        self._errors = channel.condition.errors

    # --------------------------------------------------------------------------- how it is

    def condition(self, now: float) -> wire.CanErrorState:
        """The controller's state; OFF too where no device replied for 0.1 s to requests (CAN_BUS_STATE)."""
        return wire.CanErrorState.OFF if self.dead(now) else self.channel.condition.line

    def dead(self, now: float) -> bool:
        """Return whether the controller is off the wire, or no device acknowledges or answers."""
        return self.channel.condition.line is wire.CanErrorState.OFF or now - self._silent_since >= DEAD

    def void(self) -> None:
        """From here on no goal given before may leave."""
        self.goals = None
        self.epoch = self.epoch + 1

    def span(self, exchange: CanTransaction, beside: int = 0) -> float:
        """Bus time (s) that it takes both ways, with so many frames `beside` it."""
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
        return goals.rows if goals is not None else self._nobody

    def send(self, exchange: CanTransaction, now: float, *, goals: bool = False, order: bool = False) -> None:
        """Begin a transaction: late frames of the last one are dropped, then everything leaves.

        `goals`: those that are pending go before it. `order`: it is sent on a dead line too.

        Raises PortError; PortFull when the queue was still full: it is purged, goals are dropped, an urgent
        order is sent later.
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
        except OutputQueueFull:
            self._thrown_away()
            self._excuse(now)
            raise
        except PortError:
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
        self.told |= goals.rows

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
        """A dead line: nothing old waits in it, and ten times a second it is asked."""
        self.void()
        self._excuse(now)
        if order or len(self.urgent) or now - self._purged >= DEAD:
            self._purged = now
            self.channel.purge()
            self._thrown_away()
            return exchange
        return CanTransaction(NOTHING, self._none)

    def _excuse(self, now: float) -> None:
        """Permit late answers of all: an adapter may have kept unacknowledged frames, and send them later."""
        np.maximum(self._owed, now + LATE, out=self._owed)

    def _thrown_away(self) -> None:
        """What waited in the port is gone, an urgent order perhaps too."""
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
            least = AROUND * self._sent_frames + payload + LEAST * self._wanted
            self.earliest = min(begin + least * self._bit + self._late[cyclic], self.deadline)
        else:
            self.earliest = -inf
        if waits and self._silent_since == inf:
            self._silent_since = now

    def feed(self, now: float) -> bool:
        """Take what has arrived; True when the transaction is complete. Raises PortError."""
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
        """When to look next, and how much later than the wire alone says the next answers may be looked for.

        What is coming is looked at again when all of it can be there, not frame by frame.
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
        """Our own frames are out: each answered, or there was time for them and for what was heard.

        Else the transaction ends when they are: what follows would find the adapter busy.
        """
        if self.exact or len(self._decode().answers) + int(self.heard.count.sum()) >= self._sent_frames:
            return True
        self.deadline = min(self.deadline, self._busy + self._count * self._frame)
        return now >= self.deadline

    def end(self) -> CanTransaction | None:
        """End the transaction; what was heard stands in `heard` until the next one. Never raises."""
        exchange = self.exchange
        self.exchange = None
        self._done = True
        if exchange is not None and not self.idle:
            heard = self._decode()
            if self.exact or self._exact(exchange, heard):
                self._silent_since = inf
                self._leaving = NOTHING
                return exchange
            self.spoke |= heard.count > 0
            self._judge(heard, self._surplus(exchange, heard), self.sent)
            self._owed[self._missing_replies(exchange, heard)] = self.sent + LATE
            if heard.count.any() or heard.answers:
                self._silent_since = inf
                self._leaving = NOTHING
        return exchange

    @property
    def idle(self) -> bool:
        """Whether this transaction sent nothing and received nothing."""
        return self._sent_frames == self._count == 0

    def _exact(self, exchange: CanTransaction, heard: GroupFeedback) -> bool:
        """Every frame was asked for, of everybody, and there was no other: the healthy reading."""
        self.exact = (
            self._count == self._everything == len(heard.count)
            and exchange.acks is None
            and not (heard.answers or heard.strangers or heard.masters)
            and np.array_equal(heard.count, self.expect)
        )
        return self.exact

    def _decode(self) -> GroupFeedback:
        if self._looked != self._count:
            self.heard = self.fleet.decode_frames(joined(self._frames))
            self._looked = self._count
            self.exact = False
        return self.heard

    def _complete(self, exchange: CanTransaction) -> bool:
        heard = self._decode()
        if self._exact(exchange, heard) and exchange.states is None:
            return True
        if (self.asked & (heard.count < self.expect)).any():
            return False
        if not exchange.registers <= _read_addresses(heard):
            return False
        if exchange.acks is not None and (exchange.acks & ~self._spoke(heard)).any():
            return False
        return exchange.states is None or not (exchange.states & (heard.enabled < 0)).any()

    def _spoke(self, heard: GroupFeedback) -> Bools:
        spoke = heard.count > 0
        spoke[[each.row for each in heard.answers]] = True
        return spoke

    # --------------------------------------------------------------------------- what came unasked

    def _look_back(self, frames: Frames, now: float) -> None:
        """Process the frames that arrived after the end of the last transaction."""
        before = self._errors
        self._errors = self.channel.condition.errors
        self.strays += max(0, self._errors - before)
        self.aside = None
        if not len(frames):
            return
        heard = self.aside = self.fleet.decode_frames(frames)
        self.spoke |= heard.count > 0
        surplus = np.where(self.fleet.replies, heard.count, 0)
        np.add.at(surplus, [each.row for each in heard.answers if not heard.count[each.row]], 1)
        self._judge(heard, surplus, now)
        if heard.count.any():
            self._silent_since = inf

    def _surplus(self, exchange: CanTransaction, heard: GroupFeedback) -> Ints:
        """Frames (m,) of ours that nobody asked for. What is sent of itself (ODrive) is never one, and a
        write may be answered by an acknowledgement, by feedback, or by both."""
        surplus = np.where(self.fleet.replies, np.maximum(heard.count - self.expect, 0), 0)
        asked = {row for row, _ in exchange.registers}
        for each in heard.answers:
            if each.row in asked:  # a register may be told in both forms, or two in one frame (RobStride)
                surplus[each.row] = max(0, surplus[each.row] - 1)
            elif not heard.count[each.row]:
                surplus[each.row] += 1
        if exchange.acks is not None:
            surplus[exchange.acks] = 0
        return surplus

    def _missing_replies(self, exchange: CanTransaction, heard: GroupFeedback) -> Bools:
        """Return the actuators (m,) that may still answer: incomplete ones, and those written to."""
        short: Bools = heard.count < self.expect
        told = _read_addresses(heard)
        short[[row for row, address in exchange.registers if (row, address) not in told]] = True
        return short if exchange.acks is None else short | exchange.acks

    def _judge(self, heard: GroupFeedback, surplus: Ints, now: float) -> None:
        """Count strangers, other masters, and `surplus` (m,). Who is not waited for may be late."""
        owing = self._owed > now
        late = int(surplus[owing & self.asked].sum())
        foreign = heard.strangers + heard.masters + int(surplus[~owing].sum())
        self.foreign += foreign
        self.strays += BYTES * (foreign + late)


def _read_addresses(heard: GroupFeedback) -> set[tuple[int, int]]:
    """Row and address of what was read; the acknowledgement of a write, late perhaps, is no reading."""
    return {(each.row, each.address) for each in heard.answers if not each.written}
