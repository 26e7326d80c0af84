"""Rows 13 to 21 under the fake clock: what goes wrong in servos, at their shafts and in their supply."""

from __future__ import annotations

import numpy as np

from tests.proof.faults.fault import Fault
from tests.proof.faults.world import AWAY, BRAKE, LONGEST, World
from twind import link
from twind.robot.modes import Motion, RobotState

BOOT = 1.1  # s until a servo that restarted is asked again
ROUND = 0.2  # s between two readings of temperature, voltage and clock
STATUS = 0.05  # s between two readings of torque, hardware error and watchdog
HELD = 30.0  # s that a robot that stands by itself is held after a stop of ours
LIMP = ("FOLLOW_ERR", "DAMP")  # a way down with a joint that does not follow ends softly
HOT = 70.0  # °C: the robot is lowered
OVERHEATING = 4
OVERLOAD = 32
ELECTRIC = 16


def brown_out(world: World) -> None:
    """One servo restarts: seen by its clock or its torque; the others hold or go down; it stays limp."""
    world.moving()
    row = world.row(world.joint)
    world.inject({"fault": "brown_out", "id": world.id})
    world.detected(STATUS + 0.05, codes=("STATE_STALE", "TORQUE_MISMATCH", "SERVO_REBOOTED"))
    known = ("SERVO_REBOOTED", "TORQUE_MISMATCH")
    seen = world.until(lambda: world.first_report(known) is not None, BOOT + ROUND + 0.02)
    world.claim(seen, "nobody said that a servo restarted or lost its torque")
    world.latched(*known)
    if world.free:
        _lowered(world, row)
    world.seconds(0.5)
    world.claim(not world.trace.torque(world.begun + 0.02)[:, row].any(), "it has torque again")
    world.stays_so()
    world.recover()


def _lowered(world: World, row: int) -> None:
    """A free-standing robot with a limp joint is lowered, or damped at once where the joint is of a leg."""
    if world.leg:
        world.sinks(but=[row])
    else:
        world.settles(LONGEST, but=[row])


def shutdown(world: World) -> None:
    """Overload or heat: it lets go by itself; the others hold with torque; only a restart brings it back."""
    rig = world.moving()
    bits = int(world.random.choice([OVERHEATING, OVERLOAD, OVERLOAD | ELECTRIC]))
    world.inject({"fault": "damage", "id": world.id, "bits": bits})
    world.detected()
    row = world.row(world.joint)
    if world.free:
        _lowered(world, row)
    else:
        world.holds(world.begun + world.fault.bound + BRAKE, but=[row])
    world.latched()
    world.stays_so()
    world.call(link.Disarm, seconds=14.0)
    world.until(lambda: rig.loop.procedures.rank is None, 12.0)
    world.call(link.Reset)
    world.call(link.AcquireLease)
    world.claim(world.call(link.Arm).error is not None, "armed with a hardware error")
    world.claim(not rig.register("torque_enable").any(), "torque after a refused arming")
    world.recover()


def heating(world: World) -> None:
    """A ramp of 2 to 8 °C/s from 50 °C up: told past 60, lowered past 70, armed again only when cool."""
    rig = world.moving()
    pace = float(world.random.uniform(2.0, 8.0))
    world.inject({"fault": "heat", "id": world.id, "celsius": 50.0}, inside=False)
    warm = _ramp(world, lambda s: {"fault": "heat", "id": world.id, "celsius": 50.0 + pace * s}, 0.5, 61.0)
    world.detected(since=max(warm, world.begun))
    hot = _ramp(
        world,
        lambda s: {"fault": "heat", "id": world.id, "celsius": min(75.0, 50.0 + pace * s)},
        0.5,
        HOT + 1.0,
    )
    down = world.until(lambda: rig.loop.condition.state is RobotState.FAULT, 1.0 + ROUND + 0.02)
    world.claim(down, f"not on its way down {world.now - hot:.2f} s after {HOT:.0f} °C")
    world.settles()
    world.stays_so()
    world.until(lambda: rig.loop.procedures.rank is None, 8.0)
    world.call(link.Reset)
    world.call(link.AcquireLease)
    world.claim(world.call(link.Arm).error is not None, "armed while hot")
    world.obey({"fault": "heat", "id": world.id, "celsius": 30.0})
    world.seconds(2.0)
    world.recover()


def _ramp(world, order, every, until):  # type: ignore[no-untyped-def]
    """Warmer and warmer from the injection on; when the servo itself is there."""
    protection = world.rig.virtual["main"].servos.protection
    row = world.row(world.joint)
    while True:
        world.obey(order(world.now - world.begun))
        if protection.celsius[row] >= until:
            return world.now
        world.ticks(round(every / 0.05))


def spike(world: World) -> None:
    """One reading of a temperature is a lie: nothing happens to the motion."""
    world.moving()
    celsius = float(world.random.uniform(85.0, 250.0))
    seconds = float(world.random.uniform(0.02, 0.19))
    world.inject({"fault": "spike", "id": world.id, "celsius": round(celsius), "seconds": seconds})
    world.goes_on(2.0)
    world.claim(not world.rig.loop.condition.latches, f"latched {sorted(world.rig.loop.condition.latches)}")


def sag(world: World) -> None:
    """The supply falls: told below 11.1 V, lowered below 10.5 V, armed again only when it is back."""
    rig = world.moving()
    pace = float(world.random.uniform(0.5, 4.0))  # V/s
    world.begun = world.now
    protection = rig.virtual["main"].servos.protection
    crossed = None
    low = float("inf")
    while protection.volts.min() > 10.3:
        world.obey({"fault": "supply", "volts": max(10.3, 12.0 - pace * (world.now - world.begun))})
        world.ticks(1)
        if crossed is None and protection.volts.min() < 11.0:
            crossed = world.now
        if protection.volts.min() < 10.45:
            low = min(low, world.now)
        if protection.source <= 10.3:
            break
    assert crossed is not None
    world.detected(since=crossed)
    down = world.until(lambda: rig.loop.condition.state is RobotState.FAULT, 0.1 + 0.1 + ROUND + 0.02)
    world.claim(down, f"not on its way down {world.now - low:.2f} s after 10.45 V")
    world.settles()
    world.stays_so()
    world.until(lambda: rig.loop.procedures.rank is None, 8.0)
    world.call(link.Reset)
    world.call(link.AcquireLease)
    world.claim(world.call(link.Arm).error is not None, "armed with a low supply")
    world.obey({"fault": "supply", "volts": 12.0})
    world.seconds(1.0)
    world.recover()


def stall(world: World) -> None:
    """Something holds a moving shaft: told by how far it is behind, held where it is, soft if further."""
    rig = world.moving(far=0.5)
    row = world.row(world.joint)
    world.inject({"fault": "lock", "id": world.id}, inside=False)
    crossed = world.behind(0.205, 0.1)  # beyond what rounding to ticks may hide
    if crossed is None:
        world.blame("the shaft was never behind")
        return
    world.detected(since=crossed)
    world.seconds(BRAKE)
    since = world.now
    world.seconds(0.4)
    goal = world.trace.goal(since)
    world.claim(bool((np.ptp(goal, axis=0)[world.rows([row])] == 0).all()), "goals go on")
    servos = rig.virtual["main"].servos
    gap = abs(float(goal[-1, row] - (servos.muscles.position * servos.direction + servos.shift)[row]))
    soft = int(rig.register("position_p_gain")[row]) < 1600
    world.claim(soft or gap < 40, f"the goal stays {gap:.0f} ticks from where the shaft is held")
    world.torque_stays()
    if world.free:  # held for 30 s, then lowered; who is held fast does not come to its rest: damped, unless
        world.comes_down(HELD + LONGEST, but=[row])  # it shut itself down meanwhile and is no leg
    world.obey({"fault": "free", "id": world.id})
    world.stays_so()
    world.recover()


FROZEN = 0.2  # s with the very same position, and the goal has moved meanwhile (docs/reason-codes.md)


def frozen(world: World) -> None:
    """The encoder repeats its value while its joint is driven."""
    rig = world.moving(far=0.5)
    row = world.row(world.joint)
    # While a stroke still gathers speed: there the goal moves, and goes on to, the 0.1 rad of the rule.
    quick = world.until(lambda: _gathers(world, row) > 2.5, 6.0)
    world.claim(quick, "the joint never moved as the rule needs it")
    world.inject({"fault": "freeze", "id": world.id}, inside=False)
    place = rig.loop.robot.written[world.joint]
    far = world.until(lambda: bool(abs(rig.loop.robot.written[world.joint] - place) >= 0.1), 0.6)
    world.detected(since=max(world.begun, world.now - FROZEN) if far else None)
    world.seconds(BRAKE)
    world.holds(world.now, but=())
    world.claim(rig.loop.executor.motion is not Motion.ACTIVE, "the motion goes on")
    world.obey({"fault": "freeze", "id": world.id, "on": False})
    world.stays_so()
    world.recover()


def _gathers(world: World, row: int) -> float:
    """Ticks that the goal of a servo moved in the last tick, if more than five before; else 0."""
    steps = np.abs(np.diff(world.trace.goal(world.now - 0.075)[:, row]))
    return float(steps[-1]) if len(steps) > 4 and steps[-1] > steps[0] + 1 else 0.0


def lost_turn(world: World) -> None:
    """After a power cycle a servo has lost its homing offset: nobody is armed. Or it shows another turn:
    that is put right, and it is held where it stands."""
    rig = world.live()
    world.joint = int(world.random.integers(24))
    world.id = world.id_of(world.joint)
    bus = rig.virtual["main"]
    offset = bool(world.random.random() < 0.5)
    row = bus.faults.rows(world.id)[0]
    field = bus.servos.memory.tables[row]["homing_offset"]
    keep = int(np.asarray(bus.servos["homing_offset"])[row])
    turn = float(world.random.choice([-4096.0, 4096.0]))
    world.ticks(int(world.random.integers(1, 50)))
    angle = float(rig.loop.robot.measured.position[world.joint])
    world.obey({"fault": "power", "on": False})
    world.seconds(0.3)
    shaft = bus.servos.muscles.position
    place = float(shaft[row])
    if offset:
        bus.servos.memory.store(row, field, (keep + 1024) & 0xFFFFFFFF)
    world.obey({"fault": "power", "on": True})
    if not offset:
        world.seconds(0.05)
        world.until(lambda: bool(np.isinf(bus.servos.power.boots_at).all()), 3.0)
        rig.advance_servos()
        shaft[row] = place + turn
        bus.servos.invalidate_cache()
    world.begun = world.now
    world.until(lambda: rig.loop.condition.state is RobotState.CONNECTED, 4.0)
    world.seconds(1.5)
    world.begun = world.now
    world.call(link.AcquireLease)
    reply = world.call(link.Arm)
    codes = {each["code"] for each in (reply.parameters or {}).get("findings", [])}
    codes |= {event.code for event in world.events}
    world.outcome.delay = 0.0
    if not offset and reply.error is None:
        away = abs(float(rig.loop.robot.measured.position[world.joint]) - angle)
        world.claim(away < 0.01 and abs(float(shaft[row]) - place - turn) < 5, "not held where it stands")
        world.call(link.Disarm)
    else:
        world.claim(reply.error is not None, "armed with a servo that lost its place")
        world.claim(bool(codes & set(world.fault.codes)), f"refused for {sorted(codes)}")
        world.claim(not world.trace.torque(0.0).any(), "torque was on")
    world.obey({"fault": "power", "on": False})
    world.seconds(0.3)
    shaft[row] = place
    bus.servos.memory.store(row, field, keep & 0xFFFFFFFF)
    world.obey({"fault": "power", "on": True})
    world.seconds(2.5)
    world.recover()


def tripped(world: World) -> None:
    """The loop is away for 120 to 200 ms: servos stop by themselves, and take nothing until armed anew."""
    rig = world.moving()
    world.tap.take_report("stopped", world.now)
    rig.clock.time += float(world.random.uniform(0.12, 0.2))
    world.begun = world.now
    world.ticks(1)
    world.claim(bool((rig.register("bus_watchdog") == 255).all()), "no watchdog tripped")
    world.detected(STATUS + 0.02)
    world.stands(world.begun + BRAKE)
    world.latched()
    world.torque_stays()
    world.stays_so()
    world.recover()


FOLLOW = 0.1 + 0.03 + 0.01 + 0.02  # s: threshold, the servo's own lag, refresh, 2 ticks
ROWS = (
    Fault(
        13,
        "servo restarts (brown-out)",
        ("SERVO_REBOOTED", "TORQUE_MISMATCH", "STATE_STALE"),
        0.1,
        "others hold or go down, it stays limp",
        brown_out,
        also=(*AWAY, "DEVICE_MISSING", "MIRROR_DRIFT", *LIMP),
    ),
    Fault(
        14,
        "overload or heat shutdown",
        ("SERVO_ALERT",),
        0.03,
        "others hold with torque",
        shutdown,
        also=("TORQUE_MISMATCH", "MIRROR_DRIFT", "BUS_ERRORS", "STATE_STALE", *LIMP),
    ),
    Fault(15, "slow overheating", ("OVERTEMP",), 1.0 + ROUND + 0.02, "lowered above 70 °C", heating),
    Fault(16, "false temperature", (), 0.0, "motion goes on", spike, also=("OVERTEMP",)),
    Fault(17, "voltage sag", ("VOLTAGE",), 0.1 + ROUND + 0.02, "lowered below 10.5 V", sag),
    Fault(
        18,
        "stall, contact",
        ("FOLLOW_ERR", "OVERCURRENT"),
        FOLLOW,
        "holds where it is measured",
        stall,
        # A motor that pushes warms, and may shut itself down: who is rebooted is away for a moment.
        also=("BUS_ERRORS", "STATE_STALE", "SERVO_ALERT", "MIRROR_DRIFT", "PATH_TOLERANCE", "OVERTEMP"),
    ),
    Fault(
        19,
        "frozen encoder",
        ("SENSE_FROZEN", "FOLLOW_ERR"),
        0.2 + 0.05 + 0.02,  # threshold, refresh (looked at every 50 ms), 2 ticks
        "hold",
        frozen,
        also=("MIRROR_DRIFT", "SENSE_JUMP"),
    ),
    Fault(
        20,
        "turn or homing lost",
        ("CALIB_MISMATCH", "OUT_OF_LIMIT", "ARM_FAILED", "SERVO_REBOOTED"),
        0.0,
        "arming refused, no torque",
        lost_turn,
        also=(*AWAY, "SENSE_JUMP", "DEVICE_MISSING", "CALIB_MISMATCH"),
    ),
    Fault(
        21,
        "watchdog tripped",
        ("WATCHDOG_TRIPPED",),
        STATUS + 0.02,
        "stands until armed anew",
        tripped,
        also=("LOOP_LATE", "STATE_STALE", "BUS_ERRORS", "TIME_GAP"),
    ),
)
