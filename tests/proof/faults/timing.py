"""Rows 22 to 30 under the fake clock: the loop is late, killed, stopped, hung; clocks jump."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from tests.proof.faults.fault import Fault
from tests.proof.faults.world import AWAY, BRAKE, World
from tests.support.daemon_rig import Rig
from twind.loop.procedures.torque_readback import torque_inherited
from twind.loop.process.service_notify import Notifier
from twind.robot.modes import Motion, RobotState
from twind_drivers.virtual.virtual_serial_bus import VirtualBus

LATE = 0.03  # s: at once, refresh, 2 ticks


def hog(world: World) -> None:
    """Ticks take 12 to 90 ms, once or several times: told, re-timed, never caught up."""
    rig = world.moving()
    times = int(world.random.integers(1, 4))
    longest = 0.0
    for number in range(times):  # the same warning is not told again within 10 s: the first one is looked at
        length = float(world.random.uniform(0.012 if number else 0.035, 0.09))
        longest = max(longest, length)
        world.within(lambda length=length: _pass(rig, length))
        if not number:
            world.detected(length + LATE)
        world.ticks(int(world.random.integers(2, 10)))
    world.claim(not rig.loop.condition.latches, f"latched {sorted(rig.loop.condition.latches)}")
    world.torque_stays()
    if longest < 0.05:
        world.goes_on()
    else:
        world.seconds(BRAKE)
        if rig.loop.executor.motion is not Motion.ACTIVE:
            world.holds(world.now)
    world.joint = int(world.random.integers(24))
    world.move()
    world.goes_on()


def _pass(rig: Rig, seconds: float) -> None:
    rig.clock.time += seconds


def collection(world: World) -> None:
    """A pause below 10 ms: at most told, and the motion goes on."""
    rig = world.moving()
    for _ in range(int(world.random.integers(1, 4))):
        world.within(lambda: _pass(rig, float(world.random.uniform(0.001, 0.006))))
        world.ticks(int(world.random.integers(1, 10)))
    world.goes_on()
    world.claim(not rig.loop.condition.latches, f"latched {sorted(rig.loop.condition.latches)}")


class Killed(BaseException):
    """The process is no more: nothing after this happens."""


class Heir(Rig):
    """Another daemon on the same servos."""

    def __init__(self, before: Rig) -> None:
        self._before = before
        super().__init__(before.robot.name)
        self.clock.time = before.clock.time
        self.zeros = before.zeros

    def _virtual(self, bus: str, start: Any) -> VirtualBus:
        return self._before.virtual[bus]


def killed(world: World) -> None:
    """SIGKILL anywhere in a tick: servos stop by themselves, torque on; the next daemon moves nothing."""
    rig = world.moving()
    left = int(world.random.integers(1, 40))
    now = rig.clock.now

    def dying() -> float:
        nonlocal left
        left -= 1
        if left <= 0:
            raise Killed
        return now()

    rig.clock.now = dying  # type: ignore[method-assign]
    try:
        while True:
            rig.ticks(1)
    except Killed:
        del rig.clock.now  # type: ignore[attr-defined]
    world.begun = world.now
    world.tap.take_report("killed", world.now)
    for _ in range(60):
        rig.clock.time += 0.01
        world.note()
    world.trips(world.now)
    world.claim(bool((rig.register("torque_enable") == 1).all()), "torque went off")
    place = world.trace.place(world.begun + 0.12 + BRAKE - 0.2)
    world.claim(bool((np.ptp(place, axis=0) <= 3.0).all()), "shafts go on")
    world.outcome.delay = float(np.nanmax(rig.virtual["main"].servos.trip_delay))
    world.tap.take_report("servos", world.now, velocity={}, trip_delay={})
    rest = rig.counts
    heir = world.take(Heir(rig))
    world.tap.take_report("born", world.now)
    world.until(lambda: heir.loop.condition.state is RobotState.CONNECTED, 3.0)
    world.seconds(0.5)
    world.claim(
        heir.loop.condition.state is RobotState.CONNECTED,
        f"the next daemon is {heir.loop.condition.state.value}",
    )
    world.claim(
        torque_inherited(heir.loop) and not heir.loop.torque.armed,
        "torque that was found on is not inherited",
    )
    world.claim(float(np.abs(heir.counts - rest).max()) <= 2.0, "a restart moved a joint")
    world.claim(bool((heir.register("torque_enable") == 1).all()), "torque went off")
    world.recover()
    rig.close()


def stopped(world: World) -> None:
    """SIGSTOP, a debugger, a virtual machine that freezes: 0.05 to 30 s. No burst of old goals afterwards."""
    rig = world.moving()
    pause = float(10 ** world.random.uniform(np.log10(0.05), np.log10(30.0)))
    world.tap.take_report("stopped", world.now)
    before = rig.register("goal_position").astype(int)
    world.within(lambda: _pass(rig, pause))
    world.begun = world.now
    world.ticks(1)
    step = np.abs(rig.register("goal_position").astype(int) - before)
    world.claim(int(step.max()) <= 28, f"a goal jumped {step.max()} ticks")  # 4 rad/s, 10 ms
    tripped = pause > 0.11
    world.detected(0.07, codes=("WATCHDOG_TRIPPED", "TIME_GAP") if tripped else ("LOOP_LATE",))
    if tripped:
        world.stands(world.begun + BRAKE)
        world.latched("WATCHDOG_TRIPPED", "TIME_GAP")
        world.stays_so()
        world.recover()
    else:
        world.seconds(1.0)
        world.torque_stays() if not rig.loop.condition.latches else world.recover()


def hang(world: World) -> None:
    """A tick that does not end for seconds: servos stop by themselves, the service manager hears nothing."""
    rig = world.moving()
    alive: list[float] = []

    class CountingNotifier(Notifier):
        def alive(self, now: float) -> None:
            alive.append(rig.clock.now())

    object.__setattr__(rig.loop.parts, "notifier", CountingNotifier({}))
    world.ticks(3)
    world.claim(len(alive) == 3, "the service manager is not told that the loop lives")
    length = float(world.random.uniform(0.3, 5.0))
    world.tap.take_report("stopped", world.now)

    def stand() -> None:
        until = rig.clock.time + length
        while rig.clock.time < until:
            rig.clock.time += 0.02
            world.trace.look()

    begun = world.now
    world.within(stand)
    gap = float(np.diff([*alive, world.now]).max()) if alive else 0.0
    world.claim(gap >= length - 0.02, "the service manager was told that a hung loop lives")
    world.begun = begun
    world.claim(bool((rig.register("bus_watchdog") == 255).all()), "no watchdog tripped")
    delays = rig.virtual["main"].servos.trip_delay
    world.claim(float(np.nanmax(delays)) <= 0.12, f"watchdogs tripped up to {np.nanmax(delays):.3f} s late")
    world.begun = begun + length
    world.detected(0.07 + 0.02, codes=("WATCHDOG_TRIPPED", "TIME_GAP"))
    world.stands(world.now + BRAKE)
    world.latched("WATCHDOG_TRIPPED", "TIME_GAP")
    world.stays_so()
    world.recover()


@contextmanager
def _wall(offset: float) -> Iterator[None]:
    """The wall clock is off by that much from now on."""
    real = time.time
    real_ns = time.time_ns
    time.time = lambda: real() + offset
    time.time_ns = lambda: real_ns() + int(offset * 1e9)
    try:
        yield
    finally:
        time.time = real
        time.time_ns = real_ns


def wall_clock(world: World) -> None:
    """NTP, or a hand, sets the clock by up to ten years: nobody notices."""
    world.moving()
    world.begun = world.now
    far = float(world.random.choice([-1.0, 1.0]) * 10 ** world.random.uniform(-2.0, 8.5))
    with _wall(far):
        world.goes_on()
        world.arm_again()
    world.goes_on()


def suspended(world: World) -> None:
    """The machine sleeps: monotonic time stands still, servos do not. Disarmed, whatever they say."""
    rig = world.moving()
    asleep = float(10 ** world.random.uniform(np.log10(0.15), 3.0))
    world.tap.take_report("stopped", world.now)
    for bus in rig.virtual.values():
        servos = bus.servos
        servos.heard_at -= asleep  # their time went on without ours
        servos.readings.origin -= asleep
        servos.invalidate_cache()
    _boot_time(rig, asleep)
    world.begun = world.now
    world.ticks(1)
    world.detected(LATE)
    world.stands(world.now + BRAKE)
    world.latched("TIME_GAP", "WATCHDOG_TRIPPED", "SERVO_REBOOTED")
    world.stays_so()
    world.recover()


def _boot_time(rig: Rig, asleep: float) -> None:
    """CLOCK_BOOTTIME is that much further than before, where the clock of the loop knows of it."""
    rig.clock.slept += asleep


LATER = (
    "VOLTAGE",
    "LOOP_LATE",
    "STATE_STALE",
    "BUS_ERRORS",
    "RX_SHAPE",
    "TIME_GAP",
    "LEASE_LOST",
    "WATCHDOG_TRIPPED",
)
ROWS = (
    Fault(22, "ticks take too long", ("LOOP_LATE",), LATE, "re-timed; a hold at most", hog, also=LATER),
    Fault(23, "pause of a collector", (), 0.0, "motion goes on", collection, also=("LOOP_LATE",)),
    Fault(
        24,
        "killed in motion",
        (),
        0.12,
        "servos stop, torque stays; a restart moves nothing",
        killed,
        also=(*AWAY, "MIRROR_DRIFT"),
    ),
    Fault(
        25,
        "stopped for 0.05 to 30 s",
        ("LOOP_LATE", "WATCHDOG_TRIPPED", "TIME_GAP"),
        0.07,
        "no old goals, stands",
        stopped,
        also=(*LATER, "HW_DISCONNECTED", "SERVO_REBOOTED"),
    ),
    Fault(
        28,
        "a tick hangs",
        ("WATCHDOG_TRIPPED", "TIME_GAP", "LOOP_LATE"),
        0.07,
        "servos stop, no word to the service manager",
        hang,
        also=(*LATER, "HW_DISCONNECTED"),
    ),
    Fault(29, "wall clock set", (), 0.0, "nothing", wall_clock),
    Fault(
        30,
        "machine suspended",
        ("TIME_GAP", "WATCHDOG_TRIPPED"),
        LATE,
        "disarmed or held until armed anew",
        suspended,
        also=(*LATER, "SERVO_REBOOTED", "HW_DISCONNECTED"),
    ),
)
