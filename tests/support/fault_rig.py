"""Rig of the fault runs: servos that never stand still, a recorder of their registers, a judge.

The judge knows the registers from inside the servos and the joints from the robot file. Of the daemon it uses
what it reports, and nothing of how it came to it.
"""

from collections import deque
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.support.daemon_rig import Rig
from twind.robot.arrays import Bools, Floats
from twind.robot.joint_state import JointState
from twind.robot.trajectory import Trajectory
from twind_drivers.dynamixel.packet import Framer, Instruction
from twind_drivers.virtual.servo_physics import RPM, FirstOrderPhysics
from twind_drivers.virtual.virtual_serial_bus import VirtualBus
from twind_drivers.virtual.virtual_servos import REFRESH

EPS = 1e-6  # s
TICK = 0.01  # s: a register as reported was true at its stamp, or one tick before
SETTLED = 0.1  # s: one without a stamp of its own was true within that (docs/reason-codes.md, X3)
WRITES = {
    Instruction.WRITE,
    Instruction.REG_WRITE,
    Instruction.SYNC_WRITE,
    Instruction.BULK_WRITE,
    Instruction.ACTION,
    Instruction.REBOOT,
    Instruction.FACTORY_RESET,
    Instruction.CLEAR,
    Instruction.BACKUP,
}
SPEED = 600.0  # ticks/s of a joint that a hand moves: 6 of them between two readings at 100 Hz
REACH = 300.0  # ticks either way


class Moved(FirstOrderPhysics):
    """Joints that hands move to and fro, each at its own pace, with torque or without; not blocked ones."""

    def advance(self, now: float) -> None:
        """Never two readings in a row with the same position."""
        dt = now - self._time
        if dt <= 0.0:
            return
        self._time = now
        if not hasattr(self, "way"):
            self.middle = self.position.copy()
            self.way = np.where(np.arange(len(self.position)) % 2, 1.0, -1.0)
            self.pace = SPEED * np.linspace(0.8, 1.2, len(self.position))
        free = ~self._blocked
        self.position += free * self.way * self.pace * dt
        out = (self.position - self.middle) * self.way > REACH
        self.way[out] *= -1.0
        self.velocity[:] = free * self.way * self.pace * 60.0 / (4096.0 * RPM)
        self.current[:] = free * (40.0 + np.rint(self.position) % 50)


class RegisterRecorder:
    """Registers of one bus over time: each refresh of the readings, the rest at each look."""

    READINGS = (("present_position", 4), ("present_velocity", 4), ("present_current", 2))
    SLOW = (
        ("torque_enable", 1, False),
        ("hardware_error_status", 1, False),
        ("bus_watchdog", 1, False),
        ("present_input_voltage", 2, False),
        ("present_temperature", 1, False),
    )

    def __init__(self, bus: VirtualBus) -> None:
        self.bus = bus
        memory = bus.servos.memory
        self._readings = [memory.column(key, size, signed=True) for key, size in self.READINGS]
        self._slow = [memory.column(key, size, signed=sign) for key, size, sign in self.SLOW]
        self.readings: deque[tuple[float, NDArray[np.int64]]] = deque(maxlen=64)
        self.slow: deque[tuple[float, NDArray[np.int64]]] = deque(maxlen=1024)
        refresh = bus.servos.readings.refresh

        def seen(now: float, *rest: Any) -> None:
            refresh(now, *rest)
            self.readings.append((now, np.array([each.get() for each in self._readings], np.int64)))

        bus.servos.readings.refresh = seen  # type: ignore[method-assign]

    def look(self, now: float) -> None:
        self.bus.advance(now)
        self.slow.append((now, np.array([each.get() for each in self._slow], np.int64)))

    def shown(self, since: float, until: float) -> NDArray[np.int64]:
        """(k, 3, m): what the readings were refreshed to in that time."""
        found = [each for time, each in self.readings if since - EPS <= time <= until + EPS]
        return np.array(found, np.int64).reshape(len(found), 3, len(self.bus.servos.tripped))

    def held(self, since: Floats) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """(k, 5, m) slow registers at the last looks, and (k, m) those back to `since` (m,)."""
        looks: list[tuple[float, NDArray[np.int64]]] = []
        for look in reversed(self.slow):
            looks.append(look)
            if look[0] <= since.min():
                break
        after = np.array([time for time, _ in looks])[:, None] > since
        near = np.vstack([np.ones_like(after[:1]), after[:-1]])
        return np.array([each for _, each in looks]), near


class Judge:
    """Judges every exchange of a rig: each joint right, or stale and marked, or absent. `wrong`: the rest.

    Right: equal, to the count, to what the servo's registers held at some moment from the beginning of the
    exchange (less the millisecond in which a servo refreshes) to the stamp that the daemon gives it.
    """

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.wrong = list[str]()
        self.fresh = self.stale = 0  # readings of joints judged so far
        self.witnesses = {name: RegisterRecorder(bus) for name, bus in rig.virtual.items()}
        specs = {joint.name: joint for joint in rig.robot.joints}
        joints = [specs[name] for name in rig.names]
        self._zero = np.array([rig.zeros[joint.name] for joint in joints], np.float64)
        turn = np.array([joint.type.ticks_per_turn for joint in joints])
        self._counts = np.array([joint.sign * joint.ratio for joint in joints]) * turn / (2.0 * np.pi)
        self._last: JointState | None = None
        self._said: tuple[Floats, ...] = ()
        exchange = rig.loop.hardware.exchange

        def judged(goal: Floats | None, now: float) -> JointState:
            self._look()
            state = exchange(goal, now)
            self._look()
            try:  # the loop would take an error of the judge for one of its own, and go on
                with np.errstate(invalid="ignore"):
                    self._readings(replace(state, position=self._kept(state)), now)
                    self._slow()
            except Exception as error:
                self.wrong.append(f"the judge itself failed: {error!r}")
            return state

        rig.loop.hardware.exchange = judged  # type: ignore[method-assign]

    def _kept(self, state: JointState) -> Floats:
        """Positions as they were read: of who is not placed the state shows none, and the reading counts."""
        readings = self.rig.loop.hardware.readings
        return np.where(np.isnan(state.position) & ~readings.placed, readings.position, state.position)

    def verdict(self, report: str = "") -> None:
        """Raises AssertionError that names what was wrong and what was ordered (`report`)."""
        wrong = self.wrong
        self.wrong = []
        assert not wrong, "\n".join([report, *wrong[:20]])

    def _look(self) -> None:
        for witness in self.witnesses.values():
            witness.look(self.rig.clock.now())

    def _blame(self, joints: Bools, what: str, *numbers: Any) -> None:
        for place in np.flatnonzero(joints)[:3].tolist():
            shown = [each[..., place].tolist() if isinstance(each, np.ndarray) else each for each in numbers]
            self.wrong.append(f"{self.rig.clock.now():.4f} s {self.rig.names[place]}: {what}: {shown}")

    # ------------------------------------------------------------------------------- readings

    def _readings(self, state: JointState, begun: float) -> None:
        last = self._last
        now = self.rig.clock.now()
        self._last = state
        stamp = state.time - state.age
        right = np.zeros(len(stamp), np.bool_)
        refreshed: NDArray[np.int64] | None = None
        for _, bus in self.rig.loop.hardware.pairs:
            shown = self.witnesses[bus.name].shown(begun - REFRESH, now)
            right[bus.joints] = self._same(state, bus, shown)
            if not right[bus.joints].all():
                refreshed = np.zeros((*shown.shape[:2], len(stamp)), np.int64)
                refreshed[..., bus.joints] = shown
        heard = state.heard
        self.fresh += int(heard.sum())
        self.stale += int((~heard).sum())
        counts = self._zero + state.position * self._counts
        self._blame(heard & ~right, "fresh and wrong: counts, what registers held", counts, refreshed)
        early = heard & ~((stamp >= begun - EPS) & (stamp <= now + EPS))
        self._blame(early, "fresh with a stamp outside its exchange: stamp, begun, now", stamp, begun, now)
        if last is None:
            return
        before = last.time - last.age
        never = ~heard & np.isinf(before)
        absent = np.isnan(state.position) & np.isnan(state.velocity) & np.isposinf(state.age)
        self._blame(never & ~absent, "never heard, and yet a number: counts, age", counts, state.age)
        kept = (state.position == last.position) & (state.velocity == last.velocity)
        old = ~heard & ~never
        self._blame(old & ~kept, "not heard, and yet another number: counts", counts)
        aged = np.abs(stamp - before) <= EPS
        self._blame(old & ~aged, "not heard, and yet a new stamp: stamp, before", stamp, before)

    def _same(self, state: JointState, bus: Any, shown: NDArray[np.int64]) -> Bools:
        """Joints of a bus (m,) whose three values are those of one refresh of their registers."""
        at = bus.joints
        position = np.abs(self._zero[at] + state.position[at] * self._counts[at] - shown[:, 0]) < 1e-6
        velocity = np.abs(state.velocity[at] - shown[:, 1] * bus.velocity_scale) < 1e-9
        effort = np.abs(state.effort[at] - shown[:, 2] * bus.effort_scale) < 1e-9
        known = np.isfinite(bus.effort_scale)
        same: Bools = (position & velocity & (effort | ~known)).any(axis=0)
        return same

    # ------------------------------------------------------------------------------- slow registers

    def _slow(self) -> None:
        """Each new report of torque, error, watchdog, voltage, temperature was true when it was read."""
        slow = self.rig.loop.hardware.slow
        now = self.rig.clock.now()
        volts = np.where(np.isnan(slow.voltage), -1.0, np.rint(slow.voltage * 10.0))
        warmth = np.where(np.isnan(slow.temperature), -1.0, slow.temperature)
        said = [np.asarray(each, np.float64) for each in (slow.torque, slow.fault, slow.watchdog)]
        said += [volts, warmth, slow.status_time.copy()]
        before = self._said or tuple(np.full_like(each, -1.0) for each in said)
        self._said = tuple(each.copy() for each in said)
        again = said[5] != before[5]
        names = ("torque", "hardware error", "watchdog", "voltage", "temperature")
        for _, bus in self.rig.loop.hardware.pairs:
            at = bus.joints
            changed = [(told[at] != old[at]) for told, old in zip(said[:5], before[:5], strict=True)]
            if not (again[at].any() or any(each.any() for each in changed)):
                continue
            since = np.where(again[at], np.minimum(said[5][at], now) - TICK, now - SETTLED)
            registers, held = self.witnesses[bus.name].held(since)
            for row, name in enumerate(names):
                told = said[row][at]
                news = changed[row] | (again[at] & (row < 3))
                bad = np.zeros(len(slow.torque), np.bool_)
                bad[at] = news & (told >= 0.0) & ~((registers[:, row] == told) & held).any(axis=0)
                self._blame(bad, f"{name} as reported was not so at its stamp", said[row], now - said[5])


class Wire:
    """Every packet that leaves for the servos: well formed; in mirror no writes, in live goals in bounds."""

    def __init__(self, rig: Rig, *, writes: bool) -> None:
        self.rig = rig
        self.wrong = list[str]()
        self._writes = writes
        self._goals: dict[tuple[str, int], int] = {}
        self._limits = {
            bus.name: {
                id: (int(low), int(high), float(rig.loop.robot.limits.velocity[place] / abs(scale)))
                for id, low, high, place, scale in zip(
                    bus.ids, bus.lower, bus.upper, bus.joints, bus.scale, strict=True
                )
            }
            for bus in rig.loop.robot.joints.buses
        }
        for name, bus in rig.virtual.items():
            self._tap(name, bus)

    def _tap(self, name: str, bus: VirtualBus) -> None:
        receive = bus.receive

        def tapped(data: bytes, now: float) -> None:
            if data:
                self._see(name, bus, data)
            receive(data, now)

        bus.receive = tapped  # type: ignore[method-assign]

    def _see(self, name: str, bus: VirtualBus, data: bytes) -> None:
        framer = Framer(status=False)
        packets = list(framer.feed(data))
        if framer.discarded or len(framer):
            self.wrong.append(f"{name}: bytes that are no packet: {data.hex(' ')}")
        for packet in packets:
            if packet.instruction in WRITES and not self._writes:
                self.wrong.append(f"{name}: a mirror writes: {packet}")
            if packet.instruction == Instruction.SYNC_WRITE and packet.params[:4] == b"\x74\0\x04\0":
                table = np.frombuffer(packet.params[4:], np.uint8).reshape(-1, 5)
                goals = table[:, 1:].copy().view("<i4")[:, 0]
                self._judge(name, bus, zip(table[:, 0].tolist(), goals.tolist(), strict=True))

    def _judge(self, name: str, bus: VirtualBus, goals: Iterable[tuple[int, int]]) -> None:
        """W1: inside the calibrated range. W3: one step from the last goal; W4: or where the servo is."""
        ids = bus.servos.registers.ids()
        here = bus.servos.muscles.position * bus.servos.direction + bus.servos.shift
        for id, goal in goals:
            low, high, fastest = self._limits[name][id]
            step = fastest * self.rig.loop.robot.period + 1.0
            before = self._goals.get((name, id), goal)
            place = float(here[ids.index(id)])
            if not low <= goal <= high:
                self.wrong.append(f"{name}/{id}: goal {goal} outside {low}..{high}")
            # Present is what was read up to 50 ms ago, of a joint that moved meanwhile.
            if abs(goal - before) > step and abs(goal - place) > 5.0 * step:
                where = f"the last goal {before}, the servo at {place:.1f}"
                self.wrong.append(f"{self.rig.clock.now():.3f} {name}/{id}: goal {goal}, {where}")
            self._goals[name, id] = goal

    def verdict(self, report: str = "") -> None:
        """Raises AssertionError."""
        assert not self.wrong, "\n".join([report, *self.wrong[:20]])


def nod_all(rig: Rig, seconds: float = 60.0, far: float = 0.2) -> Trajectory:
    """Every joint from where it is towards the middle of its travel and back, again and again."""
    here = (
        rig.loop.executor.reference.position
        if rig.loop.executor.reference
        else rig.loop.robot.measured.position
    )
    middle = (rig.loop.robot.limits.lower + rig.loop.robot.limits.upper) / 2.0
    there = here + np.clip(middle - here, -far, far)
    knots = int(seconds)
    position = np.where(np.arange(knots)[:, None] % 2, here, there)
    return Trajectory(
        np.arange(1.0, knots + 1.0), position, np.ones(len(here), np.bool_), np.zeros_like(position)
    )
