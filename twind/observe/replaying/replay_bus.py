"""One serial bus of a recording, as a port serves it: bytes in, bytes out, by the time of the recording.

A request that the recording has, near that moment and of the same bytes, gets the recorded bytes with their
noise, cuts and delays. Servos with the recorded registers answer all other requests.
"""

import heapq
from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Callable, Sequence
from itertools import count, pairwise
from math import inf
from types import SimpleNamespace
from typing import Any

from twind.observe.replaying.device_state_tracker import BusTimeline
from twind.observe.replaying.recorded_exchanges import FAST, DeviceReply, RecordedExchange, asks, packets
from twind.observe.replaying.replay_servos import ReplayPosition, ReplayServos, specs, still
from twind_drivers.dynamixel.packet import STATUS_OVERHEAD, Instruction, status
from twind_drivers.virtual.half_duplex_wire import BITS
from twind_drivers.virtual.shown_position_log import ShownPositionLog
from twind_drivers.virtual.virtual_serial_bus import VirtualBus

NEAR = 0.6  # of a period of the loop: a question so far from where it was asked is still the same one.
# A question that is asked seldom may be further away: a reply that was late once delays all slow reads behind
# it. At most this part of the time between two equal questions, and one round of the registers that report
# lost torque.
APART = 0.45
ROUND = 0.06  # s: torque, hardware error and watchdog are read twenty times a second
USUAL = 0.5  # s after the beginning in which is looked for what is asked in every tick
WOKEN = 0.001  # s, half of what a driver waits beyond the time on the wire
PATIENCE = 1.0  # s after which the replay begins with another question than the one it should begin with


class ReplayBus:
    """Replayed bus that a port or the loopback serves (`virtual.served.Served`). Time is an argument, and
    never goes back."""

    kind = "dynamixel2"
    sensor = None

    def __init__(
        self,
        story: BusTimeline,
        recording: ReplayPosition,
        *,
        baud: int,
        period: float,
        armed: bool,
        now: Callable[[], float],
        leads: bool = False,
        head_start: float = 0.0,
    ) -> None:
        """`period`: of the loop, s. `armed`: at the beginning, with torque. `leads`: its first question after
        the preparations is the beginning. `now`: s, for who asks without saying when. `head_start`: s that
        answers set out earlier, where they take time on their way. Raises Unknown."""
        self.name = story.name
        self.faults = SimpleNamespace(stalled=False)
        self._story = story
        self._passage = recording
        self._leads = leads
        self._now = now
        self._near = NEAR * period
        self._head_start = head_start
        self._baud = baud
        given = specs(story, baud)

        def made(*arguments: Any, **more: Any) -> ReplayServos:
            return ReplayServos(*arguments, story=story, recording=recording, armed=armed, **more)

        self._bus = VirtualBus(story.name, given, still(len(given)), baud=baud, now=now(), made=made)
        self.servos: ReplayServos = self._bus.servos  # type: ignore[assignment]
        self._times: dict[bytes, list[float]] = {}
        self._recorded: dict[bytes, list[RecordedExchange]] = {}
        self._used: dict[bytes, int] = {}  # of those, how many cannot come any more
        for each in story.told:
            if each.asks and each.time >= recording.begin:
                self._times.setdefault(each.asks, []).append(each.time)
                self._recorded.setdefault(each.asks, []).append(each)
        self._sensors = ReplaySensors(story)
        self._first = self._usual(recording.begin)
        self._under_way: list[tuple[float, int, bytes]] = []  # s, number, bytes
        self._number = count()
        self._rest = b""
        self._waiting_since = inf
        self.verbatim = self.made = (
            0  # questions since the beginning, answered with recorded bytes, and by the registers
        )
        self.on_plug: Callable[[bool], None] = lambda there: None
        self._plugged = story.plugged(recording.begin)

    # --------------------------------------------------------------------------------- as a port sees it

    @property
    def is_plugged(self) -> bool:
        """Is the adapter there?"""
        self._look(self._now())
        return self._plugged

    @property
    def backlog(self) -> int:
        """Always 0: no bytes wait."""
        return 0

    @property
    def history(self) -> ShownPositionLog | None:
        """Always None: no readings are kept."""
        return None

    def flush(self) -> None:
        """Does nothing: no bytes wait."""

    def line(self, baud: int) -> None:
        """The host's port is set to `baud`."""
        self._bus.line(baud)

    def ids(self) -> list[int]:
        """Return the ids of the devices, in order of rows."""
        return self._bus.ids()

    def truth(self, now: float) -> list[dict[str, object]]:
        """Return the registers, in the form that the virtual servos report."""
        return self._bus.truth(now)

    def motor_stand_ins(self) -> dict[str, str]:
        """Return nothing: a recording has no motors."""
        return {}

    def skip_time(self, seconds: float) -> None:
        """The clocks here are those of the recording."""

    def advance(self, now: float) -> None:
        """Let what happened by `now` happen."""
        self._look(now)
        self._bus.advance(now)

    def receive(self, data: bytes, now: float) -> None:
        """Bytes from the host, sent at `now`."""
        self._look(now)
        if not self._plugged:
            return
        for packet in self._take_complete_packets(data):
            if asks(packet):
                self._answer(packet, now)
            else:
                self._bus.receive(packet, now)

    def next_output_time(self) -> float:
        """Return the time of the next byte or plug event, s."""
        first = self._under_way[0][0] if self._under_way else inf
        return min(first, self._bus.next_output_time(), self._next_plug())

    def take(self, now: float) -> bytes:
        """Bytes that have arrived by `now`."""
        self._look(now)
        out = b""
        while self._under_way and self._under_way[0][0] <= now:
            out += heapq.heappop(self._under_way)[2]
        return out + self._bus.take(now)

    # --------------------------------------------------------------------------------- answers

    def _take_complete_packets(self, data: bytes) -> list[bytes]:
        """Packets that are whole by now; what can be none goes to the servos as it is."""
        data = self._rest + data
        self._rest = b""
        found = []
        end = 0
        for packet in packets(data):
            size = int.from_bytes(packet[5:7], "little") + 7
            if len(packet) < size:
                break
            found.append(packet)
            end += size
        rest = data[end:]
        if len(rest) < 10 or len(next(packets(rest), b"")):
            self._rest = rest
        elif rest:
            found.append(rest)
        return found

    def _answer(self, question: bytes, now: float) -> None:
        self._begin(question, now)
        exchange = self._find(question, self._passage.moment(now)) if self._passage.running else None
        self.servos.run_timers(now)
        if exchange is None or not all(
            self.servos.holds(each.id, each.address, each.data) for each in exchange.told
        ):
            self.made += self._passage.running
            told = self._sensors.answer(question, self._passage.moment(now))
            if told:
                at = now + BITS * (len(question) + len(told)) / self._baud
                heapq.heappush(self._under_way, (at, next(self._number), told))
            else:
                self._bus.receive(question, now)
            return
        self.verbatim += 1
        latest = self._latest(exchange) if exchange.whole else inf
        for after, data in exchange.answers:
            at = now + max(0.0, min(after, latest) - self._head_start)
            heapq.heappush(self._under_way, (at, next(self._number), data))

    def _latest(self, exchange: RecordedExchange) -> float:
        """Return how long after the request an answer may come, s.

        Bytes that the host read had come in time, however late its thread woke up.
        """
        fast = exchange.asks[7] in FAST
        told = exchange.told
        size = len(exchange.asks) + sum(len(each.data) + (4 if fast else STATUS_OVERHEAD) for each in told)
        size += sum(len(span.data) + 1 for span in exchange.writes)
        delay = max(self.servos.registers.delays(range(len(self.ids()))), default=0.0)
        return BITS * size / self._baud + (1 if fast else len(told)) * delay + WOKEN

    def _usual(self, begin: float) -> RecordedExchange | None:
        """Return the first exchange of the request sent most often after the beginning: the one of every
        tick.

        None: no request was recorded then.
        """
        soon = [each for each in self._story.told if each.asks and begin <= each.time < begin + USUAL]
        often = Counter(each.asks for each in soon).most_common(1)
        return next((each for each in soon if each.asks == often[0][0]), None) if often else None

    def _begin(self, question: bytes, now: float) -> None:
        """The first question of the recording is where its time begins to run."""
        if self._passage.running or not self._passage.due(now) or not self._leads or self._first is None:
            return
        self._waiting_since = min(self._waiting_since, now)
        if question == self._first.asks or now - self._waiting_since > PATIENCE:
            self._passage.go(now, self._first.time)

    def _find(self, question: bytes, moment: float) -> RecordedExchange | None:
        """The nearest of those that were not used yet."""
        times = self._times.get(question, [])
        used = self._used.get(question, 0)
        at = bisect_left(times, moment, lo=used)
        if at == len(times) or (at > used and moment - times[at - 1] < times[at] - moment):
            at -= 1
        if at < used or abs(times[at] - moment) > reach(times, at, self._near):
            return None
        self._used[question] = at + 1
        return self._recorded[question][at]

    # --------------------------------------------------------------------------------- the plug

    def _look(self, now: float) -> None:
        there = self._story.plugged(self._passage.moment(now))
        if there == self._plugged:
            return
        self._plugged = there
        self._rest = b""
        self._under_way.clear()
        if there:
            self._bus.faults.replug()
        else:
            self._bus.faults.unplug()
        self.on_plug(there)

    def _next_plug(self) -> float:
        """s, when the port goes or comes next."""
        if not self._passage.running:
            return inf
        moment = self._passage.moment(self._now())
        after = [at for at, _ in self._story.plugs if at > moment]
        return after[0] + self._passage.shift if after else inf


def reach(times: Sequence[float], at: int, near: float) -> float:
    """Return how far (s) from `times[at]` a question is still that one, `near` at least.

    `times`: s, ascending, when equal questions were asked.
    """
    beside = times[max(0, at - 1) : at + 2]
    gap = min((after - before for before, after in pairwise(beside)), default=inf)
    return max(near, min(ROUND, APART * gap))


AGO = 0.1  # s since its last read: for so long it repeats the values, then it is silent


class ReplaySensors:
    """Devices without a known model number, and their recorded register blocks. Times of the recording, s."""

    def __init__(self, story: BusTimeline) -> None:
        self._times: dict[int, list[float]] = {}
        self._told: dict[int, list[DeviceReply]] = {}
        for exchange in story.told:
            for each in exchange.told:
                if each.id not in story.models and each.data:
                    self._times.setdefault(each.id, []).append(exchange.time)
                    self._told.setdefault(each.id, []).append(each)

    def answer(self, question: bytes, moment: float) -> bytes:
        """Status packet of a sensor for a read at that moment; empty: no sensor, or silent then.

        Before the recording begins, all values are those that were read first.
        """
        id = question[4]
        if id not in self._told or question[7] != Instruction.READ:
            return b""
        address, size = (int.from_bytes(question[at : at + 2], "little") for at in (8, 10))
        times = self._times[id]
        place = max(0, bisect_right(times, moment) - 1)
        each = self._told[id][place]
        data = each.data[address - each.address :][:size] if address >= each.address else b""
        if moment - times[place] > AGO or len(data) != size:
            return b""
        return status(id, each.error, data)
