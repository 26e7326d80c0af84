"""Rows 5 to 12 under the fake clock: what goes wrong between daemon and servos."""

from __future__ import annotations

import numpy as np

from tests.proof.faults.fault import Fault
from tests.proof.faults.world import AWAY, BRAKE, LONGEST, World
from tests.support.daemon_rig import Rig
from twind.robot.modes import RobotState
from twind_drivers.virtual.virtual_serial_bus import VirtualBus
from twind_drivers.virtual.virtual_servos import ServoSpec

NOISY = ("RX_SHAPE", "BUS_ERRORS")
SILENT = ("STATE_STALE", "BUS_ERRORS")
GOALS = 134  # bytes of a sync write of goals to 24 servos


def flipped_answer(world: World) -> None:
    """1 to 16 bits of one or two answers: dropped, counted, not believed; the motion goes on."""
    world.moving(judge=True)
    count = int(world.random.integers(1, 3))
    bits = int(world.random.integers(1, 17))
    before = world.rejected
    world.inject({"fault": "corrupt", "count": count, "bits": bits, "id": world.id}, inside=False)
    world.counted(before)
    world.goes_on()
    world.claim(not world.rig.loop.condition.latches, "a fault was latched")


def forged_answer(world: World) -> None:
    """Sound packets of another id or length: the same."""
    world.moving(judge=True)
    before = world.rejected
    world.inject({"fault": "forge", "count": int(world.random.integers(1, 3)), "id": world.id}, inside=False)
    world.counted(before)
    world.goes_on()
    world.claim(not world.rig.loop.condition.latches, "a fault was latched")


def flipped_command(world: World) -> None:
    """Bits of what is sent: in everything, or in goals alone, which nobody answers: the robot stands."""
    rig = world.moving()
    goals = bool(world.random.random() < 0.5)
    if not goals:  # so many that no packet of a write stays whole: goals that got through would be followed
        world.inject({"fault": "mangle", "count": 1_000_000, "bits": int(world.random.integers(48, 65))})
        world.detected(codes=(*SILENT, "RX_SHAPE", "FOLLOW_ERR"), bound=0.06)
        world.stands(world.begun + 0.2 + BRAKE)
    else:
        few = int(world.random.integers(3, 17))
        world.inject({"fault": "mangle", "count": 1_000_000, "bits": few, "bytes": GOALS - 2})
        crossed = world.behind(0.205, 0.1)  # beyond what rounding to ticks may hide
        if crossed is not None:
            world.detected(since=crossed, bound=0.1 + 0.03 + 0.01 + 0.02, codes=("FOLLOW_ERR",))
        world.stands(world.now + BRAKE)
    world.obey({"fault": "clear"})
    world.stays_so()
    world.claim(rig.loop.robot.measured.heard.any(), "nobody is heard again")
    world.recover()


def babble(world: World) -> None:
    """A device talks without end: nobody is understood, the servos stop, and nothing goes on by itself."""
    world.moving(judge=True)
    world.inject({"fault": "babble"})
    world.detected()
    world.stands(world.begun + 0.12 + BRAKE)
    world.until(lambda: bool(world.rig.loop.condition.latches), 0.5)
    world.torque_stays()
    world.obey({"fault": "babble", "on": False})
    world.stays_so()
    world.claim(bool(world.rig.loop.condition.latches), "half a second of babble latched nothing")
    world.recover()


def burst(world: World) -> None:
    """1 to 40 ms of noise: told, at most a hold, and everybody is heard again by itself."""
    rig = world.moving(judge=True)
    world.inject({"fault": "noise", "seconds": float(world.random.uniform(0.005, 0.04))})
    world.detected()
    world.seconds(0.3)
    world.claim(bool(rig.loop.robot.measured.heard.all()), "not everybody is heard again")
    world.claim(not rig.loop.condition.latches, "a fault was latched")
    world.torque_stays()
    world.goes_on() if rig.loop.executor.motion == "active" else world.holds(world.now)
    world.seconds(1.1)
    world.joint = int(world.random.integers(24))
    world.move()
    world.goes_on()


def one_silent(world: World) -> None:
    """One connector is pulled: told, then everybody holds; for long, or back with its watchdog tripped."""
    rig = world.moving()
    long = bool(world.random.random() < 0.5)
    world.inject({"fault": "silence", "id": world.id})
    world.detected()
    if long:
        world.until(lambda: bool(rig.loop.condition.latches), 1.0)
        world.claim(world.now - world.begun <= 0.5 + NEXT + 0.01, "no fault when it was silent for 0.5 s")
        if world.free:  # the others are lowered; who is silent cannot be at rest: damped, let go
            world.settles(LONGEST, but=[world.row(world.joint)])
            world.sinks(but=[world.row(world.joint)])
        else:
            world.holds(world.now)
        world.latched("STATE_STALE")
    else:
        world.seconds(max(0.0, world.begun + 0.48 - world.now))
        goal = world.trace.goal(world.begun + 0.1 + 0.03 + 0.2)[:, world.rows([world.row(world.joint)])]
        world.claim(bool((np.ptp(goal, axis=0) == 0).all()), "goals go on, 0.2 s after the hold is due")
        world.torque_stays()
    world.obey({"fault": "silence", "id": world.id, "on": False})
    world.stays_so()
    world.claim(bool(rig.loop.condition.latches), "its watchdog tripped, and nothing is latched")
    world.recover()


def all_silent(world: World) -> None:
    """The chain is pulled, or has no power: told, a fault, and with power back nobody is armed."""
    world.moving()
    dark = bool(world.random.random() < 0.5)
    world.inject({"fault": "power", "on": False} if dark else {"fault": "silence"})
    world.detected()
    world.until(lambda: bool(world.rig.loop.condition.latches), 1.0)
    fault = min((event.time for event in world.events if event.code == "fault"), default=np.inf)
    world.claim(fault - world.begun <= 0.2 + 0.01 + 0.02, f"fault after {fault - world.begun:.3f} s")
    world.seconds(float(world.random.uniform(0.1, 1.5)))
    world.stands(world.now)
    world.obey({"fault": "power", "on": True} if dark else {"fault": "silence", "on": False})
    world.stays_so(2.0)
    world.recover()


class Twins(Rig):
    """One more servo hangs on the bus, with the id of another; it is silent until it is plugged in."""

    twin = 1

    def _virtual(self, bus, start):  # type: ignore[no-untyped-def]
        servos = self.made.devices[bus]
        spec = next(each for each in servos if each.id == Twins.twin)
        found = super()._virtual(bus, start)
        muscles = type(found.servos.muscles)(
            np.append(found.servos.muscles.position, 2048.0 + 300.0), now=self.clock.now()
        )
        copy = ServoSpec(spec.id, spec.model, spec.settings, spec.firmware, powered=7.0)
        baud = self.robot.bus(bus).baud
        now = self.clock.now()
        made = VirtualBus(bus, [*servos, copy], muscles, baud=baud, now=now)
        made.servos.silenced[-1] = True
        made.servos.invalidate_cache()
        return made


def duplicate(world: World) -> None:
    """Two answer to one id: at the start nobody is armed; on an armed robot everybody holds."""
    Twins.twin = int(world.random.integers(1, 25))
    rig = world.take(Twins())
    bus = rig.virtual["main"]
    world.id = Twins.twin

    def plug(on: bool) -> None:
        bus.servos.silenced[-1] = not on
        bus.servos.invalidate_cache()

    late = bool(world.random.random() < 0.5)
    if not late:
        plug(True)
        world.begun = world.now
        world.detected(1.0)
        world.seconds(1.0)
        world.claim(
            rig.loop.condition.state is not RobotState.CONNECTED or _refused(world),
            "armed with two of one id",
        )
        world.claim(not rig.register("torque_enable").any(), "torque is on")
    else:
        world.until(lambda: rig.loop.condition.state is RobotState.CONNECTED, 2.0)
        world.arm()
        world.joint = next(k for k, joint in enumerate(rig.robot.joints) if joint.id == Twins.twin)
        world.move()
        world.ticks(int(world.random.integers(20, 120)))
        plug(True)
        world.begun = world.now
        # Where the other one's answers are heard, what is told may be that it is limp and has no watchdog.
        world.detected(codes=(*world.fault.codes, "SERVO_REBOOTED", "TORQUE_MISMATCH"))
        world.seconds(0.8)
        world.claim(bool(rig.loop.condition.latches), "nothing is latched")
        world.claim(
            rig.loop.condition.state is not RobotState.ARMED,
            f"state {rig.loop.condition.state.value} with two of one id",
        )
    plug(False)
    world.stays_so()
    world.recover()


def _refused(world: World) -> bool:
    from twind import link

    world.call(link.AcquireLease)
    return world.call(link.Arm).error is not None


STALE = 0.03 + 0.01 + 0.02  # s: threshold, refresh, 2 ticks
NEXT = 0.01 + 0.02  # s: at once, refresh, 2 ticks
ROWS = (
    Fault(5, "bits flipped in an answer", NOISY, NEXT, "dropped, motion goes on", flipped_answer),
    Fault(6, "sound answer, wrong id or length", (*NOISY, "FOREIGN_TRAFFIC"), NEXT, "dropped", forged_answer),
    Fault(
        7,
        "bits flipped in commands",
        (*SILENT, "FOLLOW_ERR", "RX_SHAPE"),
        STALE,
        "robot stands",
        flipped_command,
        also=(*AWAY, "PATH_TOLERANCE", "DEVICE_MISSING"),
    ),
    Fault(
        8,
        "babbling node",
        (*NOISY, "STATE_STALE", "FOREIGN_TRAFFIC"),
        NEXT,
        "servos stop, fault",
        babble,
        also=AWAY,
    ),
    Fault(9, "burst of noise", (*NOISY, "STATE_STALE"), NEXT, "at most a hold, torque stays", burst),
    Fault(
        10,
        "one servo silent",
        ("STATE_STALE",),
        STALE,
        "others hold, then a fault",
        one_silent,
        also=(*AWAY, "DEVICE_MISSING"),
    ),
    Fault(
        11,
        "whole chain silent",
        SILENT,
        STALE,
        "fault, nobody armed when it is back",
        all_silent,
        also=(*AWAY, "SERVO_REBOOTED", "DEVICE_MISSING", "FOLLOW_ERR", "DAMP"),
    ),
    Fault(
        12,
        "two servos with one id",
        (*NOISY, "STATE_STALE", "FOREIGN_TRAFFIC", "DEVICE_MISSING", "DEVICE_MISMATCH", "SENSE_JUMP"),
        STALE,
        "arming refused; armed: hold, fault",
        duplicate,
        also=(
            *AWAY,
            "SERVO_REBOOTED",
            "TORQUE_MISMATCH",
            "OUT_OF_LIMIT",
            "CALIB_MISMATCH",
            "FOLLOW_ERR",
            "DAMP",
        ),
    ),
)
