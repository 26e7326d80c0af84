"""Row 38 under the fake clock: what goes wrong on a CAN bus of a robot that has others too."""

from __future__ import annotations

from collections.abc import Callable

from tests.proof.faults.can import CanWorld
from tests.proof.faults.fault import Fault
from tests.proof.faults.world import AWAY
from twind import link
from twind.robot.modes import RobotState
from twind_drivers.virtual.can.can_controller import CanAdapter

NEXT = 0.03  # s: told in the tick after the one that saw it
SILENT = 0.1 + 0.01 + 0.02  # s: nobody for 0.1 s, asked every tick, and two ticks
STALE = 0.03 + 0.01 + 0.02


def bus_off(world: CanWorld) -> None:
    """The controller leaves the wire, and says so."""
    world.moving()
    world.inject(world.on_bus("bus_off"))
    world.back(world.left(NEXT), world.on_bus("bus_off", on=False))


def unacknowledged(world: CanWorld) -> None:
    """The cable behind the adapter is cut: what we send waits, and goes out when it is whole again."""
    world.moving()
    world.inject(world.on_bus("unacknowledged"))
    world.back(world.left(SILENT), world.on_bus("unacknowledged", on=False))


def dark(world: CanWorld) -> None:
    """No power, and an adapter whose queue nobody can empty: power is back, and the old goals with it."""
    world.moving()
    if world.random.random() < 0.7:
        world.rig.virtual[world.bus].controller.adapter = CanAdapter(keeps=True)
    world.inject(world.on_bus("power", on=False))
    world.back(world.left(SILENT), world.on_bus("power", on=True))


def all_silent(world: CanWorld) -> None:
    """The connector of the leg is pulled."""
    world.moving()
    world.inject(world.on_bus("silence"))
    world.back(world.left(SILENT), world.on_bus("silence", on=False))


def unplugged(world: CanWorld) -> None:
    """The adapter is pulled out."""
    world.moving()
    world.inject(world.on_bus("unplug"))
    mine = world.left(NEXT, ("PORT_LOST",))
    world.back(mine, world.on_bus("replug"))


def missing(world: CanWorld) -> None:
    """One node says nothing: told, held after 0.1 s, a fault after 0.5 s; the others are heard."""
    rig = world.moving()
    world.inject(world.on_bus("silence", id=world.id))
    world.detected(STALE, codes=("STATE_STALE", "BUS_ERRORS"))
    world.until(lambda: "STATE_STALE" in rig.loop.condition.latches, 1.0)
    world.claim(world.now - world.begun <= 0.5 + NEXT + 0.01, "no fault when it was silent for 0.5 s")
    lost = [world.row(world.joint)]
    if world.free:
        world.settles(11.0, but=lost)
        world.sinks(but=lost)
    else:
        world.holds(world.now, but=lost)
    world.obey(world.on_bus("silence", id=world.id, on=False))
    world.stays_so()
    world.recover()


def restarted(world: CanWorld) -> None:
    """One node loses its power for a moment: it is limp, and has forgotten its watchdog."""
    world.moving()
    world.inject(world.on_bus("brown_out", id=world.id))
    world.detected(0.25, codes=("TORQUE_MISMATCH", "SERVO_REBOOTED", "WATCHDOG_TRIPPED"))
    world.seconds(1.0)
    lost = [world.row(world.joint)]
    world.claim(not world.trace.torque(world.now - 0.8)[:, lost].any(), "it was armed again by itself")
    world.stays_so()
    world.recover()


def damaged(world: CanWorld) -> None:
    """A node reports a fault of its own and lets go."""
    world.moving()
    world.inject(world.on_bus("damage", id=world.id, bits=int(world.random.integers(8, 15))))
    told = ("SERVO_ALERT", "WATCHDOG_TRIPPED")  # the latter where its fault is that it lost its master
    world.detected(0.05, codes=told)
    world.seconds(0.5)
    world.latched(*told)
    world.stays_so()
    world.recover()


def other_ranges(world: CanWorld) -> None:
    """A node's fields span another range than the robot file says: nobody is armed with it."""
    rig = world.live()
    world.joint = next(at for at, joint in enumerate(rig.robot.joints) if joint.bus == world.bus)
    world.id = world.id_of(world.joint)
    span = float(world.random.choice([12.0, 12.57, 25.0]))
    world.inject(world.on_bus("ranges", id=world.id, position=span, velocity=30.0, torque=10.0), inside=False)
    world.obey(world.on_bus("unplug"))
    world.ticks(3)
    world.obey(world.on_bus("replug"))
    world.begun = world.now
    world.detected(2.0, codes=("CALIB_MISMATCH", "DEVICE_MISMATCH"))
    world.call(link.AcquireLease)
    reply = world.call(link.Arm)
    world.claim(reply.error is not None, f"its position field spans {span} rad, and it was armed")
    world.claim(not world.trace.torque(0.0).any(), "torque was on")
    world.obey(world.on_bus("ranges", id=world.id, position=12.5, velocity=30.0, torque=10.0))
    world.obey(world.on_bus("unplug"))
    world.ticks(3)
    world.obey(world.on_bus("replug"))
    world.until(lambda: rig.loop.condition.state is RobotState.CONNECTED, 4.0)
    world.claim(not world.trace.torque(0.0).any(), "armed by itself")
    world.recover()


def other_master(world: CanWorld) -> None:
    """Somebody else commands a node: nothing more is written, the actuators let go by themselves."""
    world.moving()
    world.inject(world.on_bus("master", id=world.id))
    world.detected(0.2, codes=("FOREIGN_TRAFFIC",))
    world.claim(
        world.rig.loop.condition.state is RobotState.INHIBITED,
        f"state {world.rig.loop.condition.state.value}",
    )
    world.obey(world.on_bus("master", id=world.id, on=False))
    world.seconds(1.2)
    world.stays_so()
    world.recover()


def two_of_one_id(world: CanWorld) -> None:
    """A second node answers with the id of another."""
    world.moving()
    world.inject(world.on_bus("twin", id=world.id))
    world.detected(0.2, codes=("FOREIGN_TRAFFIC", "BUS_ERRORS", "STATE_STALE", "SENSE_JUMP"))
    world.until(lambda: bool(world.rig.loop.condition.latches), 1.0)
    world.claim(bool(world.rig.loop.condition.latches), "two of one id, and nothing is latched")
    world.obey(world.on_bus("twin", id=world.id, on=False))
    world.seconds(1.2)
    world.stays_so()
    world.recover()


def passive(world: CanWorld) -> None:
    """Many errors: told, and the motion goes on."""
    rig = world.moving()
    world.inject(world.on_bus("passive"))
    world.detected(NEXT)
    world.goes_on()
    world.claim(not rig.loop.condition.latches, "a fault was latched")
    world.obey(world.on_bus("passive", on=False))
    world.goes_on()


def lost_answers(world: CanWorld) -> None:
    """Some answers never come: counted, and the motion goes on."""
    rig = world.moving()
    before = world.rejected
    world.inject(world.on_bus("drop", count=int(world.random.integers(1, 4)), id=world.id), inside=False)
    world.until(lambda: world.rejected > before, 0.2)
    world.claim(world.rejected > before, "a lost answer was not counted")
    world.goes_on()
    world.claim(not rig.loop.condition.latches, "a fault was latched")


def stopped(world: CanWorld) -> None:
    """The daemon is away for longer than a watchdog: the actuators have let go, no old goal moves them."""
    rig = world.moving()
    world.begun = world.now
    rig.clock.time += float(world.random.uniform(0.13, 0.4))
    world.detected(0.1, codes=("TIME_GAP", "WATCHDOG_TRIPPED"), since=world.now)
    world.seconds(0.3)
    legs = world.of_bus("l_leg") + world.of_bus("r_leg")
    torque = world.trace.torque(world.now - 0.1)[:, legs]
    world.claim(not torque.any(), "an actuator whose watchdog ran out has torque again")
    world.limp(legs)
    world.stays_so()
    world.recover()


KINDS: tuple[Callable[[CanWorld], None], ...] = (
    bus_off,
    unacknowledged,
    dark,
    all_silent,
    unplugged,
    missing,
    restarted,
    damaged,
    other_ranges,
    other_master,
    two_of_one_id,
    passive,
    lost_answers,
    stopped,
)
LOWERED = (bus_off, unacknowledged, dark, all_silent, unplugged, missing)


def on_can(world: CanWorld) -> None:
    """One kind after the other by the seed; every third time round the robot stands by itself."""
    kind = KINDS[world.outcome.seed % len(KINDS)]
    world.free = kind in LOWERED and world.outcome.seed // len(KINDS) % 3 == 2
    kind(world)


LET_GO = ("WATCHDOG_TRIPPED", "TORQUE_MISMATCH", "SERVO_REBOOTED", "TORQUE_INHERITED", "ARM_FAILED")
ALSO = (*AWAY, *LET_GO, "PORT_LOST", "CAN_BUS_STATE", "TX_BACKLOG", "FOREIGN_TRAFFIC", "DEVICE_MISSING")
ALSO += (
    "DEVICE_MISMATCH",
    "CALIB_MISMATCH",
    "SERVO_ALERT",
    "SENSE_JUMP",
    "STEP_LIMIT",
    "RX_SHAPE",
    "LOOP_LATE",
    "TIME_GAP",
    "FOLLOW_ERR",
)
ROW = Fault(
    38,
    "CAN bus off, dark, silent, foreign",
    ("CAN_BUS_STATE",),
    SILENT,
    "bus left and emptied; others hold or are lowered",
    on_can,  # type: ignore[arg-type]
    also=ALSO,
    world=CanWorld,
)
