"""Virtual LX-16A: servos and bus in one, and what `twind-virtual` asks of the family."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import accumulate
from math import inf
from typing import Any

import numpy as np

from twind.exceptions import InvalidInput
from twind.virtual.fault_commands import SHARED_FAULTS
from twind.virtual.joint_actuators import fence
from twind.virtual.virtual_twin import (
    BenchRequest,
    EncoderFrame,
    PhysicsRequest,
    RobotBusRequest,
    VirtualBusRequest,
    VirtualTwin,
)
from twind_drivers.bus import IdentifiedDevice
from twind_drivers.virtual.faulty_byte_stream import FaultyByteStream
from twind_drivers.virtual.hinge import Hinge, ShaftGrip
from twind_drivers.virtual.serial_line_faults import SerialLineFaults
from twind_drivers.virtual.servo_physics import DriveState, FirstOrderPhysics
from twind_drivers.virtual.servo_strength import DRY, VISCOUS, MotorStrength
from twind_drivers.virtual.shaft_faults import ShaftFaults
from twind_drivers.virtual.virtual_serial_line import VirtualSerialLine
from twind_lx16a.lx16a_family import BAUD, LAST, MODEL, STALL, TURN
from twind_lx16a.lx16a_packet import (
    HEADER,
    LAST_ID,
    LxCommand,
    LxPacket,
    find_lx_packets,
    lx_packet,
)

TURNAROUND = 0.0003  # s, assumed
GAIN = 4000.0  # of the physics: full output at an error of 32 counts (assumed: no page gives the law)
VOLTS = 7.4
UNUSED = ("brown_out", "damage", "record", "freeze")  # no error byte, no history


@dataclass(frozen=True, slots=True)
class LxServoSpec:
    """One servo."""

    id: int
    model: str = MODEL
    hinge: Hinge | None = None


@dataclass(slots=True)
class VirtualLxServo:
    """State of one servo."""

    id: int
    goal: int = 0
    loaded: bool = False  # off at power-up
    silenced: bool = False
    celsius: int = 30
    limits: bytes = field(default_factory=lambda: bytes((0, 0)) + LAST.to_bytes(2, "little"))
    heard_at: float = -inf


class LxFaults(SerialLineFaults, ShaftFaults):
    """Faults of one bus, by name."""

    def __init__(self, bus: "VirtualLxBus", stream: FaultyByteStream) -> None:
        self._bus = bus
        count = len(bus.servos)
        self._blocked = np.zeros(count, np.bool_)
        self._places = np.full(count, np.nan)
        self._speeds = np.zeros(count)
        hinges = [each.hinge for each in bus.specs]
        hands = ShaftGrip(hinges, [TURN] * count, lambda row, place: place, self._hold)
        ShaftFaults.__init__(self, f"bus {bus.name}: no servo", bus.ids, hands)
        SerialLineFaults.__init__(self, bus.wire, stream)

    def require(self, id: int) -> None:
        """Raise KeyError, listing the ids, if no device has this id."""
        self.rows(id)

    def silence(self, id: int | None = None, on: bool = True) -> None:
        """Pull the connector of one servo or (None) of all."""
        for row in range(len(self._bus.servos)) if id is None else self.rows(id):
            self._bus.servos[row].silenced = on

    def supply(self, volts: float) -> None:
        """Set the bus supply, V."""
        self._bus.volts = volts
        self._bus.drive()

    def heat(self, id: int, celsius: float) -> None:
        """Set the temperature of one servo."""
        for row in self.rows(id):
            self._bus.servos[row].celsius = round(celsius)

    def clear(self) -> None:
        """Heal every fault of the line and plug in every connector."""
        SerialLineFaults.clear(self)
        self.silence(on=False)

    def _status(self, id: int, data: bytes) -> bytes:
        return lx_packet(id, LxCommand.POSITION, data)

    def _payload(self, piece: bytes) -> bytes:
        return piece[5:-1]

    def _block(self, row: int, held: bool) -> None:
        self._blocked[row] = held
        self._bus.muscles.block(self._blocked)

    def _hold(self, row: int, place: float, speed: float) -> None:
        self._places[row] = place
        self._speeds[row] = speed
        self._bus.muscles.set_hand_positions(self._places, self._speeds)

    def _set_base_pose(self, base: str) -> None:
        self._bus.muscles.set_base_pose(base)


class VirtualLxBus(VirtualSerialLine):
    """m servos on one wire (`ServableBus`). Time (s) is an argument and never goes back."""

    kind = "lx16a"
    sensor = None
    history = None

    def __init__(self, name: str, specs: Sequence[LxServoSpec], muscles: Any, **line: Any) -> None:
        """Make the bus; `line`: `wire_timing`, `adapter`, `seed`, `now`."""
        super().__init__(
            name,
            BAUD,
            wire_timing=line.get("wire_timing", True),
            adapter=line.get("adapter"),
            seed=line.get("seed", 0),
        )
        self.specs = tuple(specs)
        self.servos = [VirtualLxServo(each.id) for each in specs]
        self.muscles = muscles
        self.volts = VOLTS
        self.faults = LxFaults(self, self._stream)
        self._pending = b""
        self._now = line.get("now", 0.0)
        self.drive()

    def line(self, baud: int) -> None:
        """Set the host's port to `baud`: the servos know one rate alone."""
        self.wire.baud = baud

    def ids(self) -> list[int]:
        """Return the ids of the servos."""
        return [each.id for each in self.servos]

    def motor_stand_ins(self) -> dict[str, str]:
        """Return nothing: the vendor gives stall torque and speed."""
        return {}

    def skip_time(self, seconds: float) -> None:
        """Skip time in which the servos do not run."""

    def advance(self, now: float) -> None:
        """Let time pass without traffic."""
        if now > self._now:
            self._now = now
            self.muscles.advance(now)

    def receive(self, data: bytes, now: float) -> None:
        """Take bytes from the host, sent at `now`."""
        if self._stream.bent:
            data = self._stream.send(data, now)
        if not self.is_plugged or not data or self.wire.baud != BAUD:
            return
        self._pending += data
        found = find_lx_packets(self._pending)
        if found:
            last = lx_packet(*found[-1])
            self._pending = self._pending[self._pending.rfind(last) + len(last) :]
        self._pending = self._pending[-260:] if HEADER[:1] in self._pending else b""
        for each in found:
            at = self.wire.schedule_request(each.octets, now)
            self.advance(at)
            self._carry_out(each, at)

    def _carry_out(self, packet: LxPacket, at: float) -> None:
        pieces = []
        for row, servo in enumerate(self.servos):
            if servo.id == packet.id and not servo.silenced:
                servo.heard_at = at
                reply = self._execute(row, servo, packet.code, packet.data)
                pieces += [lx_packet(servo.id, packet.code, reply)] if reply else []
        delays = [TURNAROUND] * len(pieces)
        if self.faults.active and pieces:
            self.faults.speak([packet.id] * len(pieces), delays, pieces, joint=False)
        elif pieces:
            sizes = list(map(len, pieces))
            self.wire.schedule_replies(
                self.wire.ends(delays, sizes), list(accumulate(sizes)), b"".join(pieces)
            )

    def _execute(self, row: int, servo: VirtualLxServo, code: int, data: bytes) -> bytes:
        """Carry out a command; return the data of its reply; empty: none."""
        if code == LxCommand.MOVE and len(data) == 4:
            servo.goal = min(int.from_bytes(data[:2], "little"), LAST)
            self._set_goals()
        elif code == LxCommand.LOAD and len(data) == 1:
            if data[0] and not servo.loaded:  # holds where it stands
                servo.goal = min(max(round(float(self.muscles.position[row])), 0), LAST)
            servo.loaded = bool(data[0])
            self.drive()
        elif not data:
            place = round(float(self.muscles.position[row]))
            return {
                LxCommand.GOAL: servo.goal.to_bytes(2, "little") + b"\0\0",
                LxCommand.OFFSET: b"\0",
                LxCommand.LIMITS: servo.limits,
                LxCommand.HEAT_LIMIT: b"\x55",
                LxCommand.TEMPERATURE: bytes((servo.celsius,)),
                LxCommand.VOLTAGE: round(self.volts * 1e3).to_bytes(2, "little"),
                LxCommand.POSITION: place.to_bytes(2, "little", signed=True),
                LxCommand.MODE: bytes(4),
                LxCommand.LOADED: bytes((servo.loaded,)),
            }.get(code, b"")  # type: ignore[call-overload, no-any-return]
        return b""

    def drive(self) -> None:
        """Let the motors follow torque and supply."""
        count = len(self.servos)
        nothing = np.zeros(count)
        stall, speed = STALL
        self.muscles.drive(
            DriveState(
                np.array([each.loaded for each in self.servos], np.bool_),
                np.full(count, 3),
                nothing + GAIN,
                nothing,
                nothing,
                nothing + 100.0,
                nothing + 1920.0,
                nothing + 1000.0,
                nothing + inf,
                nothing + self.volts / VOLTS,
                1000.0,
                float(TURN),
                60.0 / TURN,
                motor=MotorStrength(
                    stall=stall, speed=speed, friction=DRY * stall, damping=VISCOUS * stall / speed
                ),
            )
        )
        self._set_goals()

    def _set_goals(self) -> None:
        self.muscles.set_goals(np.array([each.goal for each in self.servos], np.float64))

    def truth(self, now: float) -> list[dict[str, object]]:
        """Return the true state of each servo, with the keys that all families have."""
        self.advance(now)
        return [
            {
                "id": each.id,
                "position": float(self.muscles.position[row]),
                "encoder": float(self.muscles.position[row]),
                "velocity": float(self.muscles.velocity[row]),
                "goal": each.goal,
                "torque": each.loaded,
                "watchdog": -1,
                "tripped": False,
                "listening": not each.silenced,
                "heard_ago": now - each.heard_at,
                "tripped_at": None,
                "trip_delay": None,
            }
            for row, each in enumerate(self.servos)
        ]


def robot_devices(request: RobotBusRequest) -> list[tuple[LxServoSpec, EncoderFrame]]:
    """Servos of the joints of a bus. Raises InvalidInput for a rest pose beyond their counts."""
    for each in request.joints:
        if not 0 <= each.start <= LAST:
            raise InvalidInput(f"{each.joint.name}: count {each.start} of the rest pose is outside 0..{LAST}")
    return [(LxServoSpec(each.id, hinge=each.hinge), EncoderFrame()) for each in request.joints]


def bench_device(request: BenchRequest) -> LxServoSpec:
    """The servo of `--servo`. Raises InvalidInput."""
    if request.version is not None or not (request.id.isdecimal() and int(request.id) <= LAST_ID):
        raise InvalidInput(f"--servo {request.text}: an {MODEL} is ID:{MODEL}, with an id of 0..{LAST_ID}")
    return LxServoSpec(int(request.id))


def identity(servo: LxServoSpec) -> IdentifiedDevice:
    """Return the identification of a servo."""
    settings = {"homing_offset": 0, "drive_mode": 0, "operating_mode": 0}
    return IdentifiedDevice(
        servo.id, 0, MODEL, 0, settings | {"min_position_limit": 0, "max_position_limit": LAST}
    )


def physics(request: PhysicsRequest) -> Any:
    """Build the physics of one bus: part of a body, or joints without load."""
    if request.body is not None:
        return request.body.part(list(request.places))
    muscles = FirstOrderPhysics(np.array(request.start, np.float64), now=request.now)
    fence(muscles, request.hinges)
    return muscles


def virtual_bus(request: VirtualBusRequest) -> VirtualLxBus:
    """Build one bus."""
    line = request.line
    options = {"wire_timing": line.wire_timing, "adapter": line.adapter, "seed": line.seed}
    return VirtualLxBus(request.name, request.devices, request.physics, now=request.now, **options)


TWIN = VirtualTwin(
    robot_devices=robot_devices,
    bench_device=bench_device,
    identity=identity,
    physics=physics,
    laid_out=lambda specs, seed: (specs, [LAST / 2 + 10.0 * row for row in range(len(specs))]),
    bus=virtual_bus,
    faults={name: kinds for name, kinds in SHARED_FAULTS.items() if name not in UNUSED},
    truth_keys=("zero_ticks", "sign", "stops_rad", "friction_nm", "swapped_with"),
    takes_more=True,
)
