"""All buses of a robot at once.

`exchange` writes goals and read requests to every bus, collects all replies with one wait, then grants each
bus at most one further transaction in the rest of the tick. A silent servo is `heard = False`.
"""

from collections.abc import Callable, Generator, Sequence
from math import inf, nan
from typing import TypeVar

import numpy as np

from twind.loop.bus.bus_port import BusPort, PortLost, PortState
from twind.loop.bus.bus_wait import Pair, all_of, collect
from twind.loop.bus.exchange_measurements import ExchangeMeasurements
from twind.loop.bus.imu_poller import ImuPoller
from twind.loop.bus.joint_readings import JointReadings, radians, reach, resolution, ticks
from twind.loop.bus.script_run import ScriptRun
from twind.robot.arrays import Bools, Floats, Ints, some
from twind.robot.joint_map import JointBusMap, JointMap
from twind.robot.joint_state import JointState
from twind_drivers.bus import BusSample, PortError, PortErrorCause, Script, WireRangeError
from twind_drivers.bus_writer import BusWriter
from twind_drivers.clock import Clock
from twind_drivers.slow_read_rate import upkeep_stride

T = TypeVar("T")
# s kept free at the end of a tick: a rare transaction that ran into the next tick would delay its goals ...
SPARE = 0.0015
RARE = 0.004  # s kept free, while it is wanted, for a rare transaction whose reply comes late ...
RARE_SHARE = 0.4  # ... at most this share of the period
SPARE_SHARE = 0.25  # ... at most this share of the period


class Hardware:
    """The ports of a robot in `JointMap` order."""

    def __init__(
        self,
        joints: JointMap,
        ports: Sequence[BusPort],
        clock: Clock,
        period: float,
        inertial: ImuPoller | None = None,
    ) -> None:
        self.joints = joints
        self.clock = clock
        self.period = period
        self.inertial = inertial
        self.ports = tuple(ports)
        # each port with its map in the counts of the wire
        self.pairs: tuple[Pair, ...]
        self.readings = JointReadings(joints, period)
        self.slow = self.readings.slow
        self.lost: list[PortLost] = []  # ports lost since the last check
        self.clamped: WireRangeError | None = None  # why the last goals were not sent
        self.left = False  # the last goals were sent to every bus that holds
        self.sent = -inf  # s, when all requests of the last exchange had been handed to the ports
        self.quiet_until = -inf  # s: until then no packet leaves, so that the servos' watchdogs run out
        self.last_exchange = ExchangeMeasurements(len(self.ports))
        self._access = (False, False)
        self._spare = min(SPARE, period * SPARE_SHARE)
        self._rare_time = min(RARE, period * RARE_SHARE)
        self._stride = upkeep_stride(1.0 / period)
        self._turn = 0
        self._place = {port.name: number for number, port in enumerate(self.ports)}
        # ticks: whole turns subtracted from goals
        self._turns = [np.zeros_like(bus.zero) for bus in joints.buses]
        self.left_out: Bools = np.zeros(len(joints), np.bool_)  # get no goals until they are prepared
        self.resolution = np.full(len(joints), nan)  # rad per tick
        # rad: goals that may leave (WIRE_CLAMP)
        self.reach = (np.full(len(joints), nan), np.full(len(joints), nan))
        self.rejoin(joints)

    def rejoin(self, joints: JointMap) -> None:
        """Take over new goal ranges (WIRE_CLAMP); counts per rad, zeros, turns and devices stay."""
        self.joints = joints
        maps = [bus.turned(turns) for bus, turns in zip(joints.buses, self._turns, strict=True)]
        self.pairs = tuple(zip(self.ports, maps, strict=True))
        for _, bus in self.pairs:
            self.resolution[bus.joints] = resolution(bus)
            self.reach[0][bus.joints], self.reach[1][bus.joints] = reach(bus)
        for number in range(len(self.ports)):
            self._bound(number)

    def turn(self, number: int, shift: Ints) -> None:
        """Set the whole turns (m,) of a bus in ticks, which are chosen before torque.

        They are added to readings and subtracted from goals. Raises ValueError for a goal that its register
        cannot hold.
        """
        self.readings.turn(number, shift)
        if not np.array_equal(shift, self._turns[number]):
            port = self.ports[number]
            bus = self.joints.buses[number].turned(shift)
            if port.writer is not None:
                port.writer.set_goal_limits(bus.lower, bus.upper)
            self._turns[number] = shift
            self.pairs = (*self.pairs[:number], (port, bus), *self.pairs[number + 1 :])

    # --------------------------------------------------------------------------- access and life

    def access(self, *, read: bool, write: bool) -> None:
        """Open or close the ports as the mode allows: none (sim), reading (mirror), both (live)."""
        self._access = (read, write)
        for number, port in enumerate(self.ports):
            if read:
                self._enable(number)
            else:
                port.close()

    @property
    def writers(self) -> list[BusWriter]:
        """The writers that exist now."""
        return [port.writer for port in self.ports if port.writer is not None]

    @property
    def connected(self) -> bool:
        """True when every bus is open and every device identified."""
        return all([port.link is PortState.CONNECTED for port in self.ports])  # noqa: C419 - half the time

    def prepare(self, position: Floats, among: Bools | None = None) -> list[ScriptRun[None]]:
        """Clear device watchdogs with goal := position (n,), arm them, set gains; all is read back.

        Joints not `among` (n,) are left out: they get no goal until all are prepared anew. None: all joints.
        """
        return [self._prepare(pair, position, among) for pair in self.pairs if pair[0].writer is not None]

    def prepare_back(self, position: Floats, among: Bools | None = None) -> list[ScriptRun[None]]:
        """Prepare the buses that are open and identified but get no goals; the others are not touched."""
        back = [pair for pair in self.pairs if pair[0].link is PortState.CONNECTED and not pair[0].holding]
        return [self._prepare(pair, position, among) for pair in back if pair[0].writer is not None]

    def _prepare(self, pair: Pair, position: Floats, among: Bools | None) -> ScriptRun[None]:
        port, bus = pair
        mine = None if among is None else among[bus.joints]
        assert port.writer is not None  # the caller has checked it
        self.left_out[bus.joints] = False if mine is None else ~mine
        port.prepared = True
        return port.run(port.writer.prepare(ticks(bus, position), mine), urgent=True)

    def write_goals(self, position: Floats) -> list[ScriptRun[None]]:
        """Set goal := position (n,), rad, and read it back."""
        return self._order(lambda writer, bus: writer.write_goals(ticks(bus, position)))

    def torque(self, on: bool) -> list[ScriptRun[None]]:
        """Switch torque of every device on or off, and read it back."""
        return self._order(lambda writer, _: writer.torque(on))

    def damp(self) -> list[ScriptRun[tuple[int, ...]]]:
        """Make every device soft with its torque on; results: ids that did not confirm it."""
        return self._order(lambda writer, _: writer.damp())

    def read_goals(self) -> Generator[None, float, Floats]:
        """Return the goals (n,) in the registers, rad; NaN on buses that get none. Raises BusError."""
        requested = [
            (port.run(port.writer.read_goals(), urgent=True), bus)
            for port, bus in self.pairs
            if port.writer and port.holding
        ]
        yield from all_of([task for task, _ in requested])
        held = np.full(len(self.joints), nan)
        for task, bus in requested:
            if task.result is not None:
                held[bus.joints] = radians(bus, task.result)
        return held

    def _order(self, script: Callable[[BusWriter, JointBusMap], Script[T]]) -> list[ScriptRun[T]]:
        """Run the same script on the writer of every open bus, before anything else there."""
        return [port.run(script(port.writer, bus), urgent=True) for port, bus in self.pairs if port.writer]

    def hold(self, on: bool) -> None:
        """Send goals from now on to the buses that were prepared since they were opened, or to none.

        A bus that was lost and came back while the others were prepared is not among them.
        """
        self.left_out &= on
        for port in self.ports:
            port.holding = port.prepared = on and port.writer is not None and port.prepared

    @property
    def is_whole(self) -> bool:
        """True when every joint gets goals."""
        for port in self.ports:
            if not port.holding:
                return False
        return not some(self.left_out)

    @property
    def energised_joints(self) -> Bools:
        """Joints (n,) that get goals: on a bus that was armed and not lost since, and not left out."""
        found = np.zeros(len(self.joints), np.bool_)
        for port, bus in self.pairs:
            found[bus.joints] = port.holding
        return found & ~self.left_out

    @property
    def open(self) -> Bools:
        """Joints (n,) on a bus that is open."""
        found = np.zeros(len(self.joints), np.bool_)
        for port, bus in self.pairs:
            found[bus.joints] = port.reader is not None
        return found

    def clear(self) -> None:
        """Drop all queued and pending requests: after a stop no stale request may leave."""
        for port in self.ports:
            port.drop("dropped for something more urgent")
            if port.writer is not None:
                port.writer.clear()

    def give_up(self, bus: int, why: str) -> None:
        """Close the bus at that place, so that nothing queued leaves later; it counts as lost."""
        pair = self.pairs[bus]
        if pair[0].reader is not None:
            self._lose(pair, PortError(pair[0].name, why, kind=PortErrorCause.LOST))

    def reachable(self, position: Floats) -> Floats:
        """Return `position` (n,), rad, clipped to the range of goals; NaN stays."""
        return np.clip(position, *self.reach)

    def quantised(self, position: Floats) -> Floats:
        """Return the positions (n,), rad, that goals at `position` mean after rounding to ticks."""
        result = position.copy()
        for _, bus in self.pairs:
            result[bus.joints] = radians(bus, ticks(bus, position))
        return result

    # --------------------------------------------------------------------------- the exchange

    def exchange(self, goal: Floats | None, now: float) -> JointState:
        """Send goals (None: read only) and read all joints. Arrays of the result are (n,) and read-only.

        Afterwards `left` is True if the goals went out, and `clamped` is why they may not (WIRE_CLAMP).
        """
        end = now + self.period - self._spare
        if self._access[0]:
            self._open(now)
        self.clamped = None
        self.left = False
        if goal is not None:
            self._aim(goal)
        return self._read(now, end)

    def _aim(self, goal: Floats) -> None:
        try:
            for port, bus in self.pairs:
                if port.writer is not None and port.holding:
                    port.writer.goals(ticks(bus, goal))
                    self.left = True
        except WireRangeError as error:
            # all or nothing: no bus moves on a goal while another refuses its goal
            self.clamped = error
            self.left = False
            for writer in self.writers:
                writer.clear()

    def _open(self, now: float) -> None:
        for number, port in enumerate(self.ports):
            if port.reader is None and port.open(now):
                self._enable(number)

    def _enable(self, number: int) -> None:
        """Make or drop the writer as the mode requires.

        Its clamp (WIRE_CLAMP) is in the counts of the wire.
        """
        self.ports[number].enable(self._access[1])
        self._bound(number)

    def _bound(self, number: int) -> None:
        port, bus = self.pairs[number]
        if port.writer is not None and some(self._turns[number]):
            port.writer.set_goal_limits(bus.lower, bus.upper)

    def _read(self, now: float, end: float) -> JointState:
        self.last_exchange.begin(self.ports)
        self.readings.begin()
        # No request while quiet: any instruction packet feeds the watchdogs (e-manual, Bus Watchdog).
        quiet = now < self.quiet_until
        requested = []
        if not quiet:
            # Other programs delay replies by milliseconds, which costs nothing while readings are fresh. Now
            # and then the rare transactions are left out for that.
            latest = end
            for port in self.ports:
                if port.wants_time:
                    latest = end - self._rare_time
            requested = [pair for pair in self.pairs if not pair[0].resting and self._request(pair, latest)]
        sent = self.sent = self.clock.now()
        first = collect(requested, self.clock, self._lose)
        fresh: Bools = np.zeros(len(self.joints), np.bool_)
        for pair in requested:
            sample = pair[0].finish(self.clock.now())
            if sample is not None:
                self._take(pair, sample, fresh)
        is_fresh = some(fresh)
        received = self.last_exchange.end(sent, first, fresh=is_fresh)
        # The IMU is read after the servos: its late answer must not delay their readings.
        if self.inertial is not None and not quiet:
            self._sense(self.inertial, end)
        if not quiet:
            self._rare(end, now + self.period)
        time, trip = (received, received - sent) if is_fresh else (self.clock.now(), nan)
        return self.readings.state(fresh, time, trip, None if self.inertial is None else self.inertial.imu)

    def _take(self, pair: Pair, sample: BusSample, fresh: Bools) -> None:
        """Take the reading of one bus: mark its joints in `fresh` (n,)."""
        port, bus = pair
        number = self._place[port.name]
        fresh[self.readings.places[number]] = self.readings.take(number, sample)
        self.last_exchange.take(number, port, sample, self.inertial)
        self._listen(number, bus, sample)

    def _listen(self, number: int, bus: JointBusMap, sample: BusSample) -> None:
        """Read at once the register that explains the alert of each device that begins one (SERVO_ALERT).

        Not while a script that changes torque waits: alerts that come and go would delay it without end.
        """
        port = self.ports[number]
        begun = self.readings.alert(number, sample)
        if not begun or not port.alert_register or port.hurried:
            return
        for row in begun:
            if port.reader is not None and not port.full:
                port.run(port.reader.read(bus.ids[row], port.alert_register), urgent=True)

    def _sense(self, inertial: ImuPoller, end: float) -> None:
        """Read the IMU after the servos, which never wait for it."""
        pair = self.pairs[inertial.bus]
        if pair[0].reader is None:
            return
        try:
            begun = inertial.begin(pair[0], self.clock.now(), end)
        except PortError as error:
            self._handle_port_error(pair, error)
            return
        if begun:
            collect([pair], self.clock, self._lose)
            inertial.end(pair[0], self.clock.now())

    def _rare(self, end: float, last: float) -> None:
        """Run one further transaction per bus in the rest of the tick, which ends at `last` (s)."""
        self._turn += 1  # the buses take turns where not every tick is needed
        requested = [pair for number, pair in enumerate(self.pairs) if self._begin_rare(number, end, last)]
        ended = [port.name for port, _ in requested]
        if requested:
            polls = not all(port.querying for port, _ in requested)
            collect(requested, self.clock, self._lose, poll_first=polls)
            for port, _ in requested:
                port.end_rare(self.clock.now())
        # a driver may update slow registers from the cyclic reading alone
        for number, port in enumerate(self.ports):
            if port.reader is not None and (self._is_turn_of(number) or port.name in ended):
                self.readings.keep(number, port.reader.registers)

    def _is_turn_of(self, number: int) -> bool:
        """Check whether that bus has its upkeep in this tick."""
        return (self._turn + number) % self._stride == 0

    def _begin_rare(self, number: int, end: float, last: float) -> bool:
        """Begin the further transaction of a bus; False without one, or when the port was lost."""
        pair = self.pairs[number]
        if pair[0].reader is None:
            return False
        try:
            return pair[0].begin_rare(self.clock.now(), end, last, upkeep=self._is_turn_of(number))
        except PortError as error:
            self._handle_port_error(pair, error)
            return False

    def _request(self, pair: Pair, latest: float) -> bool:
        """Begin the cyclic reading of an open port; False when it was not sent, or the port was lost.

        A reply may come until `latest` (s).
        """
        reader = pair[0].reader
        if reader is None:
            return False
        try:
            reader.request(self.clock.now(), latest)
        except PortError as error:
            self._handle_port_error(pair, error)
            return False
        return True

    def _handle_port_error(self, pair: Pair, error: PortError) -> None:
        port, _ = pair
        if error.lost:
            self._lose(pair, error)
        else:  # the output is full: this packet is not sent, and the reading is missed
            port.counts.errors += 1
            self.last_exchange.traffic[self._place[port.name]].full += 1
            self.left = self.left and not port.holding

    def _lose(self, pair: Pair, error: PortError) -> None:
        port, _ = pair
        self.last_exchange.traffic[self._place[port.name]].line = 0
        port.lose(error, self.clock.now())
        self.readings.forget(self._place[port.name])
        self.lost.append(PortLost(port.name, error))
