"""Rows 1 to 4 under the fake clock: the plug, the adapter, who is behind it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from tests.proof.faults.fault import Fault
from tests.proof.faults.world import AWAY, LONGEST, World
from tests.support.daemon_rig import Rig
from twind import link
from twind.robot.modes import RobotState
from twind_drivers.dynamixel.packet import Instruction

ROBOTS = ("h24", "h24-split")


def _unplugged(world: World, pull: Callable[[World, str], None]) -> str:
    """One bus of a moving robot is pulled out; its name. It gets nothing more, the rest holds."""
    robot = ROBOTS[int(world.random.integers(2))]
    rig = world.moving(robot)
    name = str(world.random.choice(list(rig.virtual)))
    pull(world, name)
    world.detected()
    lost = world.of_bus(name)
    rows = ~world.rows(lost)
    world.seconds(0.3)
    torque = rig.register("torque_enable")[rows]
    world.claim(bool((torque == 1).all()), "a servo of the lost bus has no torque any more")
    delays = rig.virtual[name].servos.trip_delay
    world.claim(bool((delays <= 0.12).all()), "a watchdog of the lost bus did not stop it")
    world.stands(world.now, but=set(range(len(rows))) - set(lost))
    world.claim(world.tap.sent_at[name] <= world.begun + 0.011, "bytes went to the lost bus")
    if robot == "h24-split" and world.free:  # lowered; who is away cannot be at rest: damped, let go
        world.settles(LONGEST, but=lost)
        world.sinks(but=lost)
    elif robot == "h24-split":
        world.holds(world.now, 5.0, but=lost)
    world.latched()
    return name


def _back(world: World, name: str, **how: Any) -> None:
    """Plugged in again: everybody is asked who they are, nothing moves, nobody is armed; then by command."""
    rig = world.rig
    rows = ~world.rows(world.of_bus(name))
    world.seconds(float(world.random.uniform(0.05, 0.6)))
    asked = IdentificationRequests(world, name)
    goals = rig.register("goal_position")[rows]
    places = rig.counts[rows]
    since = world.now
    world.obey({"fault": "replug", "bus": name, **how})
    world.claim(world.until(lambda: rig.loop.hardware.connected, 2.0), "not identified within 2 s")
    world.seconds(0.5)
    everybody = set(rig.virtual[name].servos.registers.ids())
    world.claim(asked.ids >= everybody, f"identified without asking {sorted(everybody - asked.ids)}")
    world.claim(bool((rig.register("goal_position")[rows] == goals).all()), "a goal was written")
    moved = np.abs(world.trace.place(since)[:, rows] - places).max()
    world.claim(moved <= 2.0, f"a joint moved {moved:.1f} ticks when the bus came back")
    (port,) = [port for port in rig.loop.hardware.ports if port.name == name]
    world.claim(not port.holding, "armed by itself")
    world.claim(
        rig.loop.condition.state is RobotState.FAULT, f"state {rig.loop.condition.state.value}, not fault"
    )
    world.stays_so()
    world.recover()


class IdentificationRequests:
    """Ids of a bus that received an identification request (ping, or a read of the model) since the start."""

    def __init__(self, world: World, name: str) -> None:
        self.ids: set[int] = set()
        bus = world.rig.virtual[name]
        obey = bus.instructions.execute_packet

        def seen(packet: Any, at: float) -> Any:
            model = packet.instruction == Instruction.READ and packet.params[:2] == b"\0\0"
            if packet.instruction == Instruction.PING or model:
                self.ids.add(packet.id)
            elif (
                packet.instruction in (Instruction.SYNC_READ, Instruction.FAST_SYNC_READ)
                and int.from_bytes(packet.params[:2], "little") < 64  # EEPROM: who one is
            ):
                self.ids.update(packet.params[4:])
            return obey(packet, at)

        bus.instructions.execute_packet = seen  # type: ignore[method-assign]


def while_reading(world: World) -> None:
    """The adapter goes in the middle of an exchange, when the request is out and answers are awaited."""

    def pull(world: World, name: str) -> None:
        world.inject({"fault": "unplug", "bus": name}, inside=True)

    _back(world, _unplugged(world, pull))


def while_writing(world: World) -> None:
    """It goes between two exchanges: the next write fails."""

    def pull(world: World, name: str) -> None:
        world.inject({"fault": "unplug", "bus": name}, inside=False)

    _back(world, _unplugged(world, pull))


def renamed(world: World) -> None:
    """It comes back as another device (in process there is no name to change)."""

    def pull(world: World, name: str) -> None:
        world.inject({"fault": "unplug", "bus": name})

    _back(world, _unplugged(world, pull), renamed=True)


WRONG = ("model", "missing", "offset", "mode")


def wrong_adapter(world: World) -> None:
    """Other servos than described are on the port, from the start or after a replug: nobody is armed."""
    rig = world.take(Rig())
    late = world.random.random() < 0.5
    if late:
        world.until(lambda: rig.loop.condition.state is RobotState.CONNECTED, 2.0)
        world.obey({"fault": "unplug"})
        world.ticks(3)
    bus = rig.virtual["main"]
    servos = bus.servos
    kind = str(world.random.choice(WRONG))
    id = int(world.random.integers(1, 25))
    row = bus.faults.rows(id)[0]
    keep = {}
    table = servos.memory.tables[row]
    other = {"model": ("model_number", 1060), "offset": ("homing_offset", 512), "mode": ("operating_mode", 1)}
    key, value = other.get(kind, ("id", 250))
    keep = int(np.asarray(servos[key])[row])
    servos.memory.store(row, table[key], value)
    servos.invalidate_cache()
    world.begun = world.now
    if late:
        world.obey({"fault": "replug"})
    world.detected()
    world.call(link.AcquireLease)
    reply = world.call(link.Arm)
    world.claim(reply.error is not None, f"{kind} of id {id} is another, and it was armed")
    world.claim(not world.trace.torque(0.0).any(), "torque was on")
    world.obey({"fault": "unplug"})
    world.ticks(5)
    servos.memory.store(row, table[key], keep)
    servos.invalidate_cache()
    world.obey({"fault": "replug"})
    world.until(lambda: rig.loop.condition.state is RobotState.CONNECTED, 4.0)
    world.claim(not world.trace.torque(0.0).any(), "armed by itself")
    world.recover()


LOST = ("PORT_LOST",)
ROWS = (
    Fault(
        1,
        "unplugged while reading",
        LOST,
        0.02,
        "bus stops by watchdog, others hold",
        while_reading,
        also=AWAY,
    ),
    Fault(
        2,
        "unplugged while writing",
        LOST,
        0.02,
        "bus stops by watchdog, others hold",
        while_writing,
        also=AWAY,
    ),
    Fault(
        3,
        "back under another name",
        LOST,
        0.02,
        "identified again, disarmed, nothing moves",
        renamed,
        also=AWAY,
    ),
    Fault(
        4,
        "wrong servos on the port",
        ("DEVICE_MISMATCH", "DEVICE_MISSING", "CALIB_MISMATCH"),
        2.0,
        "no torque, arming refused",
        wrong_adapter,
        also=(*AWAY, "PORT_LOST", "OUT_OF_LIMIT"),
    ),
)
