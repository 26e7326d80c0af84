"""Virtual twin of CAN actuators: those of a robot or of the command line, and their buses.

Runs in `twind-virtual`.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import isfinite

import numpy as np

from twind.config.robot_spec import JointSpec
from twind.exceptions import InvalidInput
from twind.virtual.fault_commands import REAL, SHARED_FAULTS, FaultArguments
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
from twind_drivers.can.can_keys import FEEDBACK, MAX_ID, MAX_ODRIVE
from twind_drivers.can.can_models import MODELS, number_of
from twind_drivers.can.can_type import TAKES_COMMANDS, CanType
from twind_drivers.can.can_units import COUNT, counts
from twind_drivers.virtual.can.can_controller import CanAdapter
from twind_drivers.virtual.can.can_motor_physics import CanMotorPhysics, FirstOrderCanPhysics
from twind_drivers.virtual.can.node_spec import NodeSpec
from twind_drivers.virtual.can.virtual_can_bus import VirtualCanBus

FIRMWARE = 1
SPAN = 12.5  # rad, of a model whose position is a float
BITRATE = 1_000_000  # bit/s of a CAN bus
USB = (
    0.001  # s, a frame of full-speed USB: a CAN adapter delivers at this interval, so its reader wakes seldom
)
# Orders of a bus, as the methods of `CanFaults`.
CAN_FAULTS: FaultArguments = {
    **SHARED_FAULTS,
    "corrupt": {"count": int, "kind?": str},
    "unacknowledged": {"on?": bool},
    "bus_off": {"on?": bool},
    "passive": {"on?": bool},
    "error_frames": {"count": int},
    "ranges": {"id": int, "position": REAL, "velocity": REAL, "torque": REAL},
    "zero_lost": {"id": int, "radians": REAL},
    "wrap": {"id": int, "turns?": int},
    "twin": {"id": int, "on?": bool},
    "master": {"id": int, "on?": bool},
    "power": {"on": bool, "id?": int},
}


def robot_devices(request: RobotBusRequest) -> list[tuple[NodeSpec, EncoderFrame]]:
    """Actuators of the joints of a bus."""
    return [(replace(node(each.joint), hinge=each.hinge), EncoderFrame()) for each in request.joints]


def node(joint: JointSpec) -> NodeSpec:
    """The actuator of a joint, as its robot file describes it; its watchdog is off, as from the factory."""
    kind = joint.type
    assert isinstance(kind, CanType)
    return NodeSpec(
        joint.id,
        kind.device,
        feedback_id=joint.feedback_id or 0,
        position=kind.ranges.position_rad,
        velocity=kind.ranges.velocity_rad_s,
        torque=kind.ranges.torque_nm,
        firmware=FIRMWARE,
        family=kind.family,
    )


def bench_device(request: BenchRequest) -> NodeSpec:
    """The actuator of `--servo`, as from the factory. Raises InvalidInput."""
    most = MAX_ODRIVE if MODELS[request.model].family == "odrive" else MAX_ID
    id = request.id
    if not (id.isascii() and id.isdigit() and int(id) <= most):
        raise InvalidInput(f"--servo {request.text}: id {id} is not one of 0..{most}")
    if request.version is not None:
        raise InvalidInput(f"--servo {request.text}: a CAN actuator has no firmware to choose: BUS:ID:MODEL")
    return default_node(int(id), request.model)


def default_node(id: int, model: str) -> NodeSpec:
    """One by its model alone, as from the factory. Raises KeyError: no such model."""
    known = MODELS[model]
    return NodeSpec(
        id,
        model,
        feedback_id=id + FEEDBACK if known.family == "damiao" else 0,
        position=known.position if isfinite(known.position) else SPAN,
        velocity=known.velocity,
        torque=known.torque,
        firmware=FIRMWARE,
        family=known.family,
    )


def identity(spec: NodeSpec) -> IdentifiedDevice:
    """Return the identification of a node, as far as a calibration records it."""
    span = int(counts(spec.position))
    settings = {
        "homing_offset": 0,
        "drive_mode": 0,
        "operating_mode": TAKES_COMMANDS,
        "min_position_limit": -span,
        "max_position_limit": span,
    }
    unique = f"{spec.number:016x}" if spec.spoken() == "robstride" else None
    return IdentifiedDevice(spec.id, number_of(spec.model), spec.model, spec.firmware, settings, unique)


def physics(request: PhysicsRequest) -> CanMotorPhysics:
    """Build the actuator physics of one bus: part of a body, or shafts without load."""
    if request.body is not None:
        return request.body.impedance(list(request.places))
    shafts = FirstOrderCanPhysics(np.array(request.start, np.float64) * COUNT, now=request.now)
    fence(shafts, request.hinges)
    return shafts


def laid_out(specs: Sequence[NodeSpec], seed: int) -> tuple[Sequence[NodeSpec], list[float]]:
    """Return the actuators and their positions (counts), within half a radian of their zeros, by the seed."""
    random = np.random.default_rng(seed)
    places: list[float] = (random.uniform(-0.5, 0.5, len(specs)) / COUNT).tolist()
    return specs, places


def virtual_bus(request: VirtualBusRequest) -> VirtualCanBus:
    """Build one CAN bus. Raises InvalidInput for a family or model that is not simulated."""
    line = request.line
    try:
        return VirtualCanBus(
            request.name,
            request.devices,
            request.physics,
            bitrate=request.rate or BITRATE,
            wire_timing=line.wire_timing,
            now=request.now,
            adapter=CanAdapter(batch=USB if line.wire_timing else 0.0),
            seed=line.seed,
        )
    except (KeyError, ValueError) as error:
        raise InvalidInput(f"bus {request.name}: {error.args[0]}") from None


TWIN = VirtualTwin(
    robot_devices=robot_devices,
    bench_device=bench_device,
    identity=identity,
    physics=physics,
    laid_out=laid_out,
    bus=virtual_bus,
    faults=CAN_FAULTS,
    place_unit=COUNT,
    truth_keys=("zero_ticks", "sign", "stops_rad", "friction_nm"),
)
