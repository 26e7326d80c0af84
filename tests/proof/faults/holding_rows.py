"""Rows 41 and 42 under the fake clock: what goes wrong on buses of servos that do not stop by themselves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from tests.proof.faults.fault import Fault
from tests.proof.faults.holding import HoldingWorld, ProtocolOneWorld
from tests.proof.faults.world import AWAY
from twind.robot.modes import RobotState

NEXT = 0.03  # s: at once, refresh, 2 ticks
STALE = 0.03 + 0.01 + 0.02
SILENT = 0.1 + 0.01 + 0.02
LOST = ("STATE_STALE", "BUS_ERRORS")
OVERLOAD = 0x20


def flipped_answer(world: HoldingWorld) -> None:
    """Bits of one or two answers, against a checksum of eight bits: dropped, counted, not believed."""
    world.moving()
    before = world.rejected
    count = int(world.random.integers(1, 3))
    bits = int(world.random.integers(1, 17))
    world.inject({"fault": "corrupt", "count": count, "bits": bits, "id": world.id}, inside=False)
    world.counted(before)
    world.goes_on()
    world.claim(not world.rig.loop.condition.latches, "a fault was latched")


def forged_answer(world: HoldingWorld) -> None:
    """Sound packets of another id or length."""
    world.moving()
    before = world.rejected
    world.inject({"fault": "forge", "count": int(world.random.integers(1, 3)), "id": world.id}, inside=False)
    world.counted(before)
    world.goes_on()
    world.claim(not world.rig.loop.condition.latches, "a fault was latched")


def lost_answers(world: HoldingWorld) -> None:
    """Some answers never come: counted, and the motion goes on."""
    world.moving()
    before = world.rejected
    world.inject({"fault": "drop", "count": int(world.random.integers(1, 4)), "id": world.id}, inside=False)
    world.counted(before)
    world.goes_on()
    world.claim(not world.rig.loop.condition.latches, "a fault was latched")


def burst(world: HoldingWorld) -> None:
    """5 to 40 ms of noise: told, at most a hold, and everybody is heard again by itself."""
    rig = world.moving()
    world.inject({"fault": "noise", "seconds": float(world.random.uniform(0.005, 0.04))})
    world.detected(codes=(*LOST, "RX_SHAPE"))
    world.seconds(0.3)
    world.claim(bool(rig.loop.robot.measured.heard.all()), "not everybody is heard again")
    world.claim(not rig.loop.condition.latches, "a fault was latched")
    world.torque_stays()
    world.seconds(1.1)
    world.move()
    world.goes_on()


def babble(world: HoldingWorld) -> None:
    """A device talks without end: a fault, and nothing goes on by itself."""
    world.moving()
    world.inject({"fault": "babble"})
    world.detected(codes=(*LOST, "RX_SHAPE", "FOREIGN_TRAFFIC"))
    world.until(lambda: bool(world.rig.loop.condition.latches), 0.5)
    world.obey({"fault": "babble", "on": False})
    world.stays_so()
    world.claim(bool(world.rig.loop.condition.latches), "half a second of babble latched nothing")
    world.recover()


def one_silent(world: HoldingWorld) -> None:
    """One connector is pulled: told, then everybody holds; it keeps its last goal, also when it is back."""
    rig = world.moving()
    world.inject({"fault": "silence", "id": world.id})
    world.detected(STALE, codes=LOST)
    if world.random.random() < 0.5:
        world.until(lambda: bool(rig.loop.condition.latches), 1.0)
        world.claim(world.now - world.begun <= 0.5 + NEXT + 0.01, "no fault when it was silent for 0.5 s")
        world.holds(world.now, but=[world.row(world.joint)])
    else:
        world.seconds(float(world.random.uniform(0.15, 0.45)))
    world.obey({"fault": "silence", "id": world.id, "on": False})
    world.stands(world.now)
    world.latched(*LOST, "WATCHDOG_TRIPPED")
    world.stays_so()
    world.recover()


def all_silent(world: HoldingWorld) -> None:
    """The signal wire breaks: a fault; the servos end at their last goals and stay there when it is whole."""
    rig = world.moving()
    world.inject({"fault": "silence"})
    world.detected(STALE, codes=LOST)
    world.until(lambda: bool(rig.loop.condition.latches), 1.0)
    world.stops_where_it_was_sent(world.now)
    world.obey({"fault": "silence", "on": False})
    world.stands(world.now)
    world.recover()


def dark(world: HoldingWorld) -> None:
    """The supply fails: a fault; with power back they are limp, and nobody is armed."""
    rig = world.moving()
    world.inject({"fault": "power", "on": False})
    world.detected(STALE, codes=LOST)
    world.until(lambda: bool(rig.loop.condition.latches), 1.0)
    world.seconds(float(world.random.uniform(0.1, 1.0)))
    world.obey({"fault": "power", "on": True})
    world.stays_so(2.0)
    world.claim(not rig.register("torque_enable").any(), "torque is on after a supply failure")
    world.recover()


def unplugged(world: HoldingWorld) -> None:
    """The adapter is pulled out: the servos end at their last goals; plugged in again nobody moves."""
    rig = world.moving()
    world.inject({"fault": "unplug"})
    world.detected(NEXT, codes=("PORT_LOST", "HW_DISCONNECTED"))
    world.claim(bool(rig.loop.condition.latches), "a port was lost, and nothing is latched")
    world.stops_where_it_was_sent(world.begun)
    world.seconds(float(world.random.uniform(0.05, 1.0)))
    world.obey({"fault": "replug"})
    world.seconds(0.5)
    found = world.until(lambda: rig.loop.hardware.connected, 3.0)
    world.claim(found, "not identified within 3 s")
    world.stands(world.now)
    state = rig.loop.condition.state
    world.claim(state is RobotState.FAULT, f"state {state.value}, not fault")
    world.recover()


def restarted(world: HoldingWorld) -> None:
    """One servo loses its power for a moment: limp, reported, not armed again by itself."""
    world.moving()
    world.inject({"fault": "brown_out", "id": world.id})
    world.detected(0.25, codes=(*LOST, "TORQUE_MISMATCH", "SERVO_REBOOTED"))
    world.seconds(1.5)
    row = world.row(world.joint)
    world.claim(not world.trace.torque(world.now - 0.5)[:, row].any(), "it was armed again by itself")
    world.stays_so()
    world.recover()


def overload(world: HoldingWorld) -> None:
    """A servo reports an overload: held; where its cause has gone the robot can be armed again."""
    world.moving()
    world.inject({"fault": "damage", "id": world.id, "bits": OVERLOAD})
    world.detected(0.1, codes=("SERVO_ALERT",))
    world.seconds(0.5)
    world.claim(bool(world.rig.loop.condition.latches), "an overload latched nothing")
    world.obey({"fault": "damage", "id": world.id, "bits": 0})
    world.stays_so()
    world.recover()


def stopped(world: HoldingWorld) -> None:
    """The daemon is away for a while: no step is caught up, the motion is held."""
    rig = world.moving()
    world.begun = world.now
    rig.clock.time += float(world.random.uniform(0.13, 0.4))
    world.detected(0.1, codes=("TIME_GAP",), since=world.now)
    world.holds(world.now + 0.5)
    world.recover()


KINDS: tuple[Callable[[HoldingWorld], None], ...] = (
    flipped_answer,
    forged_answer,
    lost_answers,
    burst,
    babble,
    one_silent,
    all_silent,
    dark,
    unplugged,
    restarted,
    overload,
    stopped,
)


def on_holding_servos(world: HoldingWorld) -> None:
    """One kind after the other by the seed."""
    KINDS[world.outcome.seed % len(KINDS)](world)


ROW = Fault(
    41,
    "servos without a watchdog",
    ("RX_SHAPE", "BUS_ERRORS", "STATE_STALE"),
    NEXT,
    "held or at their last goals; nobody moves when it is over",
    on_holding_servos,  # type: ignore[arg-type]
    also=(
        *AWAY,
        *("PORT_LOST", "FOREIGN_TRAFFIC", "DEVICE_MISSING", "SERVO_ALERT", "SERVO_REBOOTED", "SENSE_JUMP"),
        *("TIME_GAP", "LOOP_LATE", "FOLLOW_ERR", "STEP_LIMIT", "ARM_FAILED", "DAMP"),
        "DEVICE_MISMATCH",  # the warning at arming: they have no watchdog
    ),
    world=HoldingWorld,
)
PROTOCOL_ONE = replace(ROW, number=42, name="servos of Protocol 1.0", world=ProtocolOneWorld)
