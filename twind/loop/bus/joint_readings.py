"""Last reading of every joint, raw ↔ SI: the only place that multiplies ticks. Does no I/O.

Takes the sample of one bus after the other. A joint without a plausible reading (SENSE_JUMP) keeps its value
and reports its age. The whole turns by which counts are off (`safety/multiturn.py`) are part of the zeros of
a bus, so that they cost a tick nothing.
"""

from math import inf, nan

import numpy as np

from twind.loop.bus.raw_counts import RawCounts
from twind.robot.arrays import Bools, Floats, Ints, every, some
from twind.robot.joint_map import JointBusMap, JointMap
from twind.robot.joint_state import Imu, JointState
from twind.robot.transmission import forth
from twind.safety.device_rules import ALERT
from twind.safety.plausibility_filter import PlausibilityFilter
from twind_drivers.bus import BusSample, SlowRegisterValues

NOWHERE = 1 << 40  # ticks: beyond every goal register
SILENT = 0.5  # s: the load of a joint without a reading for longer is unknown


def ticks(bus: JointBusMap, position: Floats) -> Ints:
    """Return goals (m,) of one bus in ticks from positions (n,) in rad, rounded to nearest.

    NaN and values that no register holds become `NOWHERE`, which every clamp refuses.
    """
    angles = position[bus.joints]
    for each in bus.linked:
        each.angles(angles)
    exact = np.rint(bus.zero + angles / bus.scale)
    there = np.abs(exact) < NOWHERE
    if not every(there):
        # The integer that a CPU makes of NaN is undefined (0 on ARM, which may be a valid goal).
        exact = np.where(there, exact, NOWHERE)
    wanted: Ints = exact.astype(np.int64)
    return wanted


def radians(bus: JointBusMap, place: Ints) -> Floats:
    """Return positions (m,) of one bus in rad from ticks (m,)."""
    angle = _angles(bus, place)
    for each in bus.linked:
        each.position(angle)
    return angle


def _angles(bus: JointBusMap, place: Ints) -> Floats:
    """Return the angles (m,) of the actuators, rad: positions, except for joints of transmissions."""
    angle: Floats = (place - bus.zero) * bus.scale
    return angle


def velocities(bus: JointBusMap, place: Ints, raw: Floats | Ints) -> Floats:
    """Return velocities (m,) of one bus in rad/s from raw ones (m,) read at ticks (m,)."""
    speed = raw * bus.velocity_scale
    for each in bus.linked:
        each.velocity(_angles(bus, place), speed)
    return speed


def efforts(bus: JointBusMap, place: Ints, raw: Floats | Ints) -> Floats:
    """Return efforts (m,) of one bus in N·m from raw ones (m,) read at ticks (m,).

    NaN of one actuator makes all joints of its transmission NaN.
    """
    effort = raw * bus.effort_scale
    for each in bus.linked:
        each.effort(_angles(bus, place), effort)
    return effort


def resolution(bus: JointBusMap) -> Floats:
    """Return the travel of one count (m,) on one bus, rad.

    With a transmission, of a count of each actuator.
    """
    found = np.abs(bus.scale)
    for each in bus.linked:
        found[each.rows] = forth(each.law) @ found[each.rows]
    return found


def reach(bus: JointBusMap) -> tuple[Floats, Floats]:
    """Return the range (m,) of goals that may be sent (WIRE_CLAMP), rad.

    The counts of a transmission's actuators reach further: not every pair of counts is a valid pose of its
    joints.
    """
    angles = (bus.lower - bus.zero) * bus.scale, (bus.upper - bus.zero) * bus.scale
    least = np.minimum(*angles)
    most = np.maximum(*angles)
    for each in bus.linked:
        least[each.rows] = each.lower
        most[each.rows] = each.upper
    return least, most


def mask_incomplete_groups(bus: JointBusMap, fresh: Bools) -> Bools:
    """Return the joints (m,) whose actuators are all `fresh` (m,)."""
    complete = fresh.copy()
    for each in bus.linked:
        complete[each.rows] = every(fresh[each.rows])
    return complete


def where(bus: JointBusMap) -> slice | Ints:
    """Return the joints of a bus as an index.

    Consecutive joints as a slice, which takes a third of the time.
    """
    first = int(bus.joints[0])
    count = len(bus.joints)
    side_by_side = np.array_equal(bus.joints, np.arange(first, first + count))
    return slice(first, first + count) if side_by_side else bus.joints


def _measured_efforts(sample: BusSample) -> Floats:
    """Return efforts (m,), raw; NaN for devices that did not report it."""
    reported = sample.heard if sample.effort_told is None else sample.effort_told
    return np.where(reported, sample.effort, nan)


class SlowReadings:
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

    def keep(self, places: slice | Ints, registers: SlowRegisterValues) -> None:
        """Store the registers of one bus."""
        self.torque[places] = registers.torque
        self.fault[places] = registers.fault
        self.watchdog[places] = registers.watchdog
        self.voltage[places] = registers.voltage
        self.temperature[places] = registers.temperature
        self.status_time[places] = registers.status_time
        self.tick[places] = registers.tick
        self.health_time[places] = registers.health_time

    def forget(self, places: slice | Ints) -> None:
        """Reset the registers of a lost bus to unknown."""
        for array in (self.torque, self.fault, self.watchdog, self.tick):
            array[places] = -1
        self.voltage[places] = self.temperature[places] = nan
        self.health_time[places] = -inf


class JointReadings:
    """The last reading of every joint. Arrays are (n,), in `JointMap` order; buses by their number there."""

    def __init__(self, joints: JointMap, period: float) -> None:
        count = len(joints)
        self.slow = SlowReadings(count)
        self.raw = RawCounts(count)
        self.jumps = np.zeros(count, np.int64)  # readings in a row that could not be (SENSE_JUMP)
        self.leaps = np.zeros(count)  # rad, how far the last of them was off
        self.alerts = np.zeros(count, np.uint8)  # error byte of the last status, 0x80 = alert
        self.position = np.full(count, nan)
        self.velocity = np.full(count, nan)
        self.effort = np.full(count, nan)
        self.load = np.full(count, nan)  # share of the current limit, by amount; NaN unknown
        self.shift = np.zeros(count, np.int64)  # ticks, whole turns: calibrated counts are raw + shift
        self.placed: Bools = np.ones(count, np.bool_)  # False: the position of the joint is unknown
        self.heard_at = np.full(count, -inf)  # s
        self._whole_at = -inf  # s, when every joint had been heard since
        self._maps = joints.buses
        self._period = period
        self._buses = list(joints.buses)  # the same, their zeros less the shift
        self.places = [where(bus) for bus in joints.buses]  # of each bus: its joints, as an index
        # of each bus: the slow registers that were stored last, and their version
        self._stored: list[tuple[SlowRegisterValues | None, int]] = [(None, 0)] * len(joints.buses)
        self._loads = [nan if bus.load_scale is None else bus.load_scale for bus in joints.buses]
        self._senses = [PlausibilityFilter(bus.fastest, period) for bus in joints.buses]

    def begin(self) -> None:
        """Reset the jumps of the last exchange: each is reported once."""
        if some(self.jumps):
            self.jumps[:] = 0

    def take(self, number: int, sample: BusSample) -> Bools:
        """Store the sample of one bus; return the mask (m,) of accepted positions."""
        heard = sample.heard
        senses = self._senses[number]
        bus = self._buses[number]
        places = self.places[number]
        self.raw.take(places, sample)
        usual = every(heard) and senses.usual(sample.position, sample.sent, sample.received)
        if not usual:
            heard = self._believe(number, sample)
            heard = mask_incomplete_groups(bus, heard) if bus.linked else heard
        position = radians(bus, sample.position)
        if usual:
            self.position[places] = position
            self.velocity[places] = velocities(bus, sample.position, sample.velocity)
            effort = sample.effort if sample.effort_told is None else _measured_efforts(sample)
            self.effort[places] = efforts(bus, sample.position, effort)
            self.load[places] = np.abs(effort) * self._loads[number]
            self.heard_at[places] = sample.received
            return heard
        rows = bus.joints[heard]
        self.position[rows] = position[heard]
        self.velocity[rows] = velocities(bus, sample.position, sample.velocity)[heard]
        effort = _measured_efforts(sample)
        self.effort[rows] = efforts(bus, sample.position, effort)[heard]
        self.load[rows] = (np.abs(effort) * self._loads[number])[heard]
        self.heard_at[rows] = sample.received
        return heard

    def turn(self, number: int, shift: Ints) -> None:
        """Set the whole turns (m,) that the counts of a bus lack, in ticks.

        Stored positions change with them.
        """
        places = self.places[number]
        moved = self.position[places] + (shift - self.shift[places]) * self._maps[number].scale
        self.shift[places] = shift
        self._buses[number] = self._maps[number].turned(shift)
        anew = radians(self._buses[number], self.raw.ticks[places])
        for each in self._maps[number].linked:  # positions of a transmission do not add up
            complete = every(self.raw.heard_at[self._maps[number].joints[each.rows]] > -inf)
            moved[each.rows] = anew[each.rows] if complete else nan
        self.position[places] = moved

    def alert(self, number: int, sample: BusSample) -> list[int]:
        """Keep the error bytes; return the places on the bus that begin to report an error (SERVO_ALERT)."""
        places = self.places[number]
        if not some(sample.error):
            self.alerts[places] = 0
            return []
        alerts = np.where(sample.heard, sample.error, 0)
        new = (alerts & ALERT) > (self.alerts[places] & ALERT)
        self.alerts[places] = alerts
        return np.flatnonzero(new).tolist()

    def keep(self, number: int, registers: SlowRegisterValues) -> None:
        """Store the slow registers of one bus, if a value is new."""
        before, version = self._stored[number]
        if registers is not before or registers.version != version:
            self._stored[number] = (registers, registers.version)
            self.slow.keep(self.places[number], registers)

    def forget(self, number: int) -> None:
        """Reset a lost bus: its registers are unknown, and its joints may be anywhere when it is back."""
        self.slow.forget(self.places[number])
        self._stored[number] = (None, 0)
        self.alerts[self.places[number]] = 0
        self._senses[number] = PlausibilityFilter(self._buses[number].fastest, self._period)

    def silence(self, bus: JointBusMap, now: float) -> float:
        """Return the seconds since any device on that bus answered; inf: never."""
        return now - float(self.heard_at[bus.joints].max())

    def loads(self, now: float) -> Floats:
        """Return the share of the current limit (n,) at `now` (s).

        NaN: unknown, or without a fresh reading.
        """
        if self._whole_at > now - SILENT:
            return self.load
        recent = now - self.heard_at <= SILENT
        return self.load if every(recent) else np.where(recent, self.load, nan)

    def where(self) -> Floats:
        """Return positions (n,), rad; NaN for joints that were never read or are not placed."""
        return self.position.copy() if every(self.placed) else np.where(self.placed, self.position, nan)

    def state(self, fresh: Bools, time: float, trip: float, imu: Imu | None = None) -> JointState:
        """Return all joints at `time` (s) with the IMU; `trip`: s that the reading took.

        Arrays are read-only.
        """
        position = self.where()
        velocity = self.velocity.copy()
        effort = self.effort.copy()
        age = time - self.heard_at
        if every(fresh):
            self._whole_at = time - trip
        for array in (position, velocity, effort, age, fresh):
            array.setflags(write=False)
        return JointState(time, position, velocity, effort, age, fresh, trip, imu)

    def _believe(self, number: int, sample: BusSample) -> Bools:
        """Drop impossible positions; without torque a hand may move a joint faster than its motor."""
        senses = self._senses[number]
        bus = self._buses[number]
        places = self.places[number]
        limp = self.slow.torque[places] == 0
        believed = senses.believe(sample.position, sample.heard, sample.sent, sample.received, limp)
        self.jumps[places] = senses.jumps
        self.leaps[places] = senses.leaps * np.abs(bus.scale)
        return believed
