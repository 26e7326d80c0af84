"""All buses of a robot at once, raw ↔ SI: the only place that multiplies ticks.

`exchange` writes goals and read requests to every bus, collects all replies with one wait, then grants each
bus at most one further transaction in the time that is left. One silent servo is `heard = False`.
"""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from math import inf, nan

import numpy as np

from twind.loop.ports import Link, Port, Task
from twind.loop.procedures import all_of
from twind.robot.arrays import Bools, Floats, every, some
from twind.robot.joints import BusMap, JointMap
from twind.robot.state import JointState
from twind.safety.device_rules import ALERT
from twind.safety.facts import Traffic
from twind.safety.senses import Senses
from twind_drivers.bus import PortError, Reader, Sample, Script, WireClamp, Writer
from twind_drivers.clock import Clock

NOWHERE = 1 << 40  # ticks: beyond every goal register


@dataclass(frozen=True, slots=True)
class Lost:
    """A port went away in this tick."""

    bus: str
    error: PortError


class Slow:
    """The slowly read registers in joint order; arrays (n,)."""

    def __init__(self, count: int) -> None:
        self.torque = np.full(count, -1, np.int8)
        self.fault = np.full(count, -1, np.int16)
        self.watchdog = np.full(count, -1, np.int16)
        self.voltage = np.full(count, nan)
        self.temperature = np.full(count, nan)
        self.status_time = np.full(count, -inf)
        self.tick = np.full(count, -1, np.int32)  # ms, the servo's own clock modulo 32768; -1 unknown
        self.health_time = np.full(count, -inf)


class Hardware:
    """The ports of a robot in `JointMap` order."""

    def __init__(self, joints: JointMap, ports: Sequence[Port], clock: Clock, period: float) -> None:
        self.joints, self.clock, self.period = joints, clock, period
        self.ports = tuple(ports)
        self.pairs: tuple[tuple[Port, BusMap], ...] = tuple(zip(self.ports, joints.buses, strict=True))
        self.slow = Slow(len(joints))
        self.lost: list[Lost] = []  # ports lost since the last look
        self.clamped: WireClamp | None = None  # why the last goals were not sent
        self.left = False  # the last goals went out, to every bus that holds
        self.quiet_until = -inf  # s: until then no packet leaves, so that the servos' watchdogs run out
        self.discarded = 0  # bytes thrown away in the last exchange (R07)
        self.traffic = tuple(Traffic() for _ in self.ports)  # of the last exchange, bus by bus
        self.jumps = np.zeros(len(joints), np.int64)  # readings in a row that could not be (R13)
        self.leaps = np.zeros(len(joints))  # rad, how far the last of them was off
        self._senses = [self._sense(bus) for bus in joints.buses]
        self.hops = (nan, nan)  # s, of the last exchange: request to first byte, first to last
        self.trips = [nan] * len(self.ports)  # s, of the last exchange: request to last byte of each bus
        self.alerts = np.zeros(len(joints), np.uint8)  # error byte of the last status, 0x80 = alert
        self._position = np.full(len(joints), nan)
        self._velocity = np.full(len(joints), nan)
        self._effort = np.full(len(joints), nan)
        self._heard_at = np.full(len(joints), -inf)
        self._access = (False, False)
        self.resolution = np.full(len(joints), nan)  # rad per tick
        for bus in joints.buses:
            self.resolution[bus.joints] = np.abs(bus.scale)

    # --------------------------------------------------------------------------- access and life

    def access(self, *, read: bool, write: bool) -> None:
        """What the mode allows: nothing (sim), reading (mirror), both (live)."""
        self._access = (read, write)
        for port in self.ports:
            if read:
                port.enable(write)
            else:
                port.close()

    def close(self) -> None:
        """Let go of every port."""
        self.access(read=False, write=False)

    @property
    def writers(self) -> list[Writer]:
        """The write halves that exist now."""
        return [port.writer for port in self.ports if port.writer is not None]

    @property
    def connected(self) -> bool:
        """Every bus is open and every device identified."""
        return all(port.link is Link.CONNECTED for port in self.ports)

    def prepare(self, position: Floats) -> list[Task[None]]:
        """Device watchdogs cleared with goal := position (n,), then armed; gains; all read back."""
        return self._order(lambda writer, bus: writer.prepare(self.ticks(bus, position)))

    def aim(self, position: Floats) -> list[Task[None]]:
        """Goal := position (n,), read back."""
        return self._order(lambda writer, bus: writer.aim(self.ticks(bus, position)))

    def torque(self, on: bool) -> list[Task[None]]:
        """Torque of every device, read back."""
        return self._order(lambda writer, _: writer.torque(on))

    def aimed(self) -> Generator[None, float, Floats]:
        """The goals (n,) that the servos hold, rad; NaN on buses that are not open. Raises BusError."""
        asked = [(port.run(port.writer.aimed(), urgent=True), bus) for port, bus in self.pairs if port.writer]
        yield from all_of([task for task, _ in asked])
        held = np.full(len(self.joints), nan)
        for task, bus in asked:
            if task.result is not None:
                held[bus.joints] = (task.result - bus.zero) * bus.scale
        return held

    def silence(self, bus: BusMap, now: float) -> float:
        """Seconds since anybody on that bus answered; inf never."""
        return now - float(self._heard_at[bus.joints].max())

    def _order(self, script: Callable[[Writer, BusMap], Script[None]]) -> list[Task[None]]:
        """The same script on the writer of every open bus, before anything else there."""
        return [port.run(script(port.writer, bus), urgent=True) for port, bus in self.pairs if port.writer]

    def hold(self, on: bool) -> None:
        """From now on goals go to the buses that are open now, and stay so; or to none."""
        for port in self.ports:
            port.holding = on and port.writer is not None

    @property
    def open(self) -> Bools:
        """Joints (n,) on a bus that is open."""
        found = np.zeros(len(self.joints), np.bool_)
        for port, bus in self.pairs:
            found[bus.joints] = port.reader is not None
        return found

    def clear(self) -> None:
        """Drop whatever is queued or pending: after a stop nothing stale may leave."""
        for port in self.ports:
            port.drop("dropped for something more urgent")
            if port.writer is not None:
                port.writer.clear()

    # --------------------------------------------------------------------------- raw ↔ SI

    def ticks(self, bus: BusMap, position: Floats) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
        """Goals (m,) of one bus in ticks, from positions (n,) in rad. Rounded to nearest.

        NaN and what no register holds become `NOWHERE`, which no clamp lets pass.
        """
        exact = np.rint(bus.zero + position[bus.joints] / bus.scale)
        # What a CPU makes of NaN as an integer is its own affair (0 on ARM, which may be a fine goal).
        wanted: np.ndarray[tuple[int], np.dtype[np.int64]] = np.where(
            np.abs(exact) < NOWHERE, exact, NOWHERE
        ).astype(np.int64)
        return wanted

    def quantised(self, position: Floats) -> Floats:
        """The positions (n,) that goals at `position` really mean, after rounding to ticks."""
        result = position.copy()
        for _, bus in self.pairs:
            result[bus.joints] = (self.ticks(bus, position) - bus.zero) * bus.scale
        return result

    def _sense(self, bus: BusMap) -> Senses:
        return Senses(bus.fastest, self.period)

    def _take(self, bus: BusMap, number: int, sample: Sample) -> Bools:
        """Keep what was read of bus `number`; whose position (m,) is believed (R13)."""
        heard, senses = sample.heard, self._senses[number]
        whole = every(heard)
        if not (whole and senses.usual(sample.position, sample.sent, sample.received)):
            heard = self._believe(bus, senses, sample)
            whole = every(heard)
        rows = slice(None) if whole else heard
        places = bus.joints[rows]
        self._position[places] = (sample.position[rows] - bus.zero[rows]) * bus.scale[rows]
        self._velocity[places] = sample.velocity[rows] * bus.velocity_scale[rows]
        self._effort[places] = sample.effort[rows] * bus.effort_scale[rows]
        self._heard_at[places] = sample.received
        self._listen(number, bus, sample)
        self.discarded += sample.discarded
        return heard

    def _believe(self, bus: BusMap, senses: Senses, sample: Sample) -> Bools:
        """Drop the positions that cannot be; where torque is off a hand may be faster than the motor."""
        limp = self.slow.torque[bus.joints] == 0
        believed = senses.believe(sample.position, sample.heard, sample.sent, sample.received, limp)
        self.jumps[bus.joints] = senses.jumps
        self.leaps[bus.joints] = senses.leaps * np.abs(bus.scale)
        return believed

    def _listen(self, number: int, bus: BusMap, sample: Sample) -> None:
        """Error bytes; who begins to say that it has a hardware error is asked for it at once (R09)."""
        if not some(sample.error):
            self.alerts[bus.joints] = 0
            return
        alerts = np.where(sample.heard, sample.error, 0)
        port = self.ports[number]
        new = (alerts & ALERT) > (self.alerts[bus.joints] & ALERT)
        for row in np.flatnonzero(new).tolist():
            if port.reader is not None and not port.full:
                port.run(port.reader.read(bus.ids[row], "hardware_error_status"), urgent=True)
        self.alerts[bus.joints] = alerts

    @staticmethod
    def _count(traffic: Traffic, port: Port, sample: Sample) -> None:
        """R06 counts who is known to be there: who is missing is told where a bus is identified."""
        whole = every(sample.heard)
        traffic.asked = port.holding or port.link is Link.CONNECTED
        traffic.bad = sample.discarded > 0 or (not whole and some(sample.asked & ~sample.heard))
        traffic.answered = whole or some(sample.heard)
        traffic.foreign = sample.foreign

    def _take_registers(self, port: Port, bus: BusMap) -> None:
        if port.reader is None:
            return
        registers, slow, places = port.reader.registers, self.slow, bus.joints
        slow.torque[places] = registers.torque
        slow.fault[places] = registers.fault
        slow.watchdog[places] = registers.watchdog
        slow.voltage[places] = registers.voltage
        slow.temperature[places] = registers.temperature
        slow.status_time[places] = registers.status_time
        slow.tick[places] = registers.tick
        slow.health_time[places] = registers.health_time

    def forget(self, bus: BusMap) -> None:
        """A lost bus: what its slow registers said is no longer known, and its joints may be anywhere."""
        for array in (self.slow.torque, self.slow.fault, self.slow.watchdog, self.slow.tick):
            array[bus.joints] = -1
        self.slow.health_time[bus.joints] = -inf
        self.alerts[bus.joints] = 0
        self._senses[self.joints.buses.index(bus)] = self._sense(bus)
        self.slow.voltage[bus.joints] = self.slow.temperature[bus.joints] = nan

    # --------------------------------------------------------------------------- the exchange

    def exchange(self, goal: Floats | None, now: float) -> JointState:
        """Goals out (None: read only), readings in. Arrays of the result are (n,) and read-only.

        Afterwards `left` says whether the goals went out, `clamped` why they may not (R22).
        """
        end = now + self.period
        self._open(now)
        self.clamped, self.left = None, False
        if goal is not None:
            self._aim(goal)
        return self._read(now, end)

    def _aim(self, goal: Floats) -> None:
        try:
            for port, bus in self.pairs:
                if port.writer is not None and port.holding:
                    port.writer.goals(self.ticks(bus, goal))
                    self.left = True
        except WireClamp as error:  # all or nothing: no bus moves on a goal that another may not have
            self.clamped, self.left = error, False
            for writer in self.writers:
                writer.clear()

    def _open(self, now: float) -> None:
        if self._access[0]:
            for port in self.ports:
                if port.open(now):
                    port.enable(self._access[1])

    def _read(self, now: float, end: float) -> JointState:
        self._begin()
        quiet = now < self.quiet_until
        asked = [] if quiet else [pair for pair in self.pairs if self._try(pair, "request")]
        sent = self.clock.now()
        first = self._collect(asked)
        received, heard = sent, np.zeros(len(self.joints), np.bool_)
        self.trips = [nan] * len(self.ports)
        for port, bus in asked:
            sample = port.finish(self.clock.now())
            if sample is not None:
                number = self.ports.index(port)
                heard[bus.joints] = self._take(bus, number, sample)
                self._count(self.traffic[number], port, sample)
                if self.traffic[number].answered:
                    received = max(received, sample.received)
                    self.trips[number] = sample.received - sample.sent
        self.hops = (first - sent, received - first) if some(heard) else (nan, nan)
        if not quiet:
            self._rare(end)
        return self._state(heard, sent, received)

    def _begin(self) -> None:
        """Forget what the last exchange brought."""
        self.discarded = 0
        if some(self.jumps):
            self.jumps[:] = 0
        for traffic in self.traffic:
            traffic.asked = traffic.bad = traffic.answered = False
            traffic.foreign = traffic.full = 0

    def _rare(self, end: float) -> None:
        """One further transaction per bus, all at once, in what is left of the tick."""
        asked = [pair for pair in self.pairs if self._try(pair, "rare", end)]
        self._collect(asked, look=not all(port.querying for port, _ in asked))
        for port, bus in asked:
            port.end_rare(self.clock.now())
            self._take_registers(port, bus)

    def _try(self, pair: tuple[Port, BusMap], what: str, end: float = inf) -> bool:
        """Begin a transaction on an open port; False where there is none, or the port was lost."""
        port, _ = pair
        if port.reader is None:
            return False
        try:
            if what == "rare":
                return port.begin_rare(self.clock.now(), end)
            port.reader.request(self.clock.now())
        except PortError as error:
            if error.lost:
                self._lose(pair, error)
            else:  # the output is full: this packet is not sent, and the reading is missed
                port.counts.errors += 1
                self.traffic[self.ports.index(port)].full += 1
                self.left = self.left and not port.holding
            return False
        return True

    def _collect(self, asked: list[tuple[Port, BusMap]], *, look: bool = False) -> float:
        """Feed every asked bus until it is done or its deadline passes; time of the first bytes (s).

        `look`: before the first wait. An answer is not there while the question still leaves (half-duplex),
        and a look costs a system call; what is never answered is done at once, and must not be waited for.
        """
        waiting = list(asked)
        first = inf
        if waiting and not look:
            self._await([port.reader for port, _ in waiting if port.reader is not None])
            first = self.clock.now()
        while waiting:
            now = self.clock.now()
            still = []
            for pair in waiting:
                reader = pair[0].reader
                if reader is None:
                    continue
                try:
                    done = reader.feed(now)
                except PortError as error:
                    self._lose(pair, error)
                    asked.remove(pair)
                    continue
                if not done and now < reader.deadline:
                    still.append((reader, pair))
            waiting = [pair for _, pair in still]
            if still:
                self._await([reader for reader, _ in still])
                first = min(first, self.clock.now())
        return min(first, self.clock.now())

    def _await(self, readers: list[Reader]) -> None:
        """Until one of them has bytes, or its time is over."""
        deadline = min(reader.deadline for reader in readers)
        self.clock.wait([reader.transport for reader in readers], deadline)

    def _lose(self, pair: tuple[Port, BusMap], error: PortError) -> None:
        port, bus = pair
        port.lose(error, self.clock.now())
        self.forget(bus)
        self.lost.append(Lost(port.name, error))

    def _state(self, heard: Bools, sent: float, received: float) -> JointState:
        somebody = some(heard)
        time = received if somebody else self.clock.now()
        trip = received - sent if somebody else nan
        state = JointState(
            time,
            self._position.copy(),
            self._velocity.copy(),
            self._effort.copy(),
            time - self._heard_at,
            heard,
            trip,
        )
        for array in (state.position, state.velocity, state.effort, state.age, state.heard):
            array.setflags(write=False)
        return state
